"""Check a splat PLY file and report findings by name, with counts and a verdict.

Conventions
-----------
* Severities: ``error`` - the file is not splats or cannot be used as they are, the verdict is no;
  ``warning`` - usable, but probably not what was meant; ``info`` - notable, normal.
* Counts are rows unless a finding says otherwise.
* Statistics are taken on the values as the file holds them: logits, logarithms, raw quaternions.
* The file is read in blocks: apart from positions, scales, opacity and a hash per row, memory does
  not grow with the file.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gscomplete.splats.filters import (
    FAR_FACTOR,
    MAX_MAGNITUDE,
    far_positions,
    middle_and_extent,
)
from gscomplete.splats.linear_values import linear_values
from gscomplete.splats.ply import splat_element
from gscomplete.splats.ply_files.header import Element, PlyError, PlyHeader, read_header
from gscomplete.splats.ply_files.layout import SplatLayout, find_layout
from gscomplete.splats.row_statistics import RowStatistics, gather_statistics
from gscomplete.splats.suspects import SuspectLimits, find_suspects

_FAINTEST_LOGIT = -math.log(254)
"""Of an opacity of 1/255, below which renderers skip a splat."""
Severity = Literal["error", "warning", "info"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One named observation about a file."""

    name: str
    severity: Severity
    count: int  # rows, or what the message says
    message: str


@dataclass(frozen=True, slots=True)
class ValidationReport:
    """What was found in a file."""

    path: str
    ok: bool  # no finding is an error
    n_splats: int  # rows of the vertex element; 0 when the file is no splat file
    sh_degree: int | None  # None when the file is no splat file
    bounds: tuple[tuple[float, ...], tuple[float, ...]] | None  # corners of the finite positions
    findings: tuple[Finding, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the JSON form."""
        return dataclasses.asdict(self)


@dataclass(frozen=True, slots=True)
class ValidationLimits:
    """Thresholds beyond which a value is reported."""

    quaternion_tolerance: float = 1e-3
    """Largest difference of a quaternion's length from 1 that counts as unit."""

    outlier_factor: float = FAR_FACTOR
    """Positions further than this many 90 % half-widths from the median are outliers."""

    far_factor: float = 1000.0
    """Distance of the splats from the origin, in their own extents, beyond which float32
    positions lose visible precision (2^-24 * 1000 = 6e-5 of the extent)."""

    min_rows_for_guesses: int = 100
    """Guesses about SH order need at least this many rows."""

    tiny_scale: float = 1e-6
    """Splats smaller than this part of the extent are invisible."""

    normal_extent: tuple[float, float] = (1e-4, 1e5)
    """Extents outside this range, in the file's units, are mentioned."""

    sh_order_margin: float = 0.3
    """By how much the channels must correlate better in the other SH order to be reported."""

    suspects: SuspectLimits = field(default_factory=SuspectLimits)
    """Where a splat is a floater, a giant, haze or a needle."""


def validate_file(path: str | Path, limits: ValidationLimits | None = None) -> ValidationReport:
    """Check one file; every fault is a finding, none an exception.

    Args:
        path: the file.
        limits: thresholds; None = the defaults of ``ValidationLimits``.
    """
    path = Path(path)
    limits = limits or ValidationLimits()
    count, degree = 0, None
    try:
        header = read_header(path)
        element = splat_element(header, path)
        layout = find_layout(element, path)
        count, degree = element.count, math.isqrt(layout.coefficients) - 1
        tolerance = limits.quaternion_tolerance
        statistics = gather_statistics(path, header, element, layout, tolerance)
    except PlyError as error:
        message = str(error).removeprefix(f"{path}: ")
        finding = Finding(error.finding, "error", 1, message)
        return ValidationReport(str(path), False, count, degree, None, (finding,))
    findings = [
        *_header_findings(header, element, layout, statistics),
        *_value_findings(statistics, limits),
        *_frame_findings(statistics, limits),
        *_suspect_findings(statistics, limits.suspects),
        *_linear_findings(statistics),
        *_sh_order_findings(statistics, limits),
    ]
    order = {"error": 0, "warning": 1, "info": 2}
    findings.sort(key=lambda finding: order[finding.severity])
    bounds = statistics.bounds()
    ok = not any(finding.severity == "error" for finding in findings)
    return ValidationReport(str(path), ok, count, degree, bounds, tuple(findings))


def _header_findings(
    header: PlyHeader, element: Element, layout: SplatLayout, rows: RowStatistics
) -> list[Finding]:
    """Findings about what the header lists and what follows the splats."""
    found = []
    if element.count == 0:
        found.append(Finding("no_splats", "error", 0, "element vertex has no rows"))
    if layout.integer:
        names = ", ".join(layout.integer)
        message = f"integer-typed splat properties (expected float): {names}"
        found.append(Finding("mistyped_property", "error", len(layout.integer), message))
    if layout.dropped_bands:
        message = "spherical harmonics of degree 4: degrees above 3 are kept but not used"
        found.append(Finding("sh_layout", "warning", 1, message))
    extra = [name for name in layout.foreign if name not in ("nx", "ny", "nz")]
    if extra:
        message = f"properties kept but not used: {', '.join(extra)}"
        found.append(Finding("foreign_properties", "info", len(extra), message))
    others = [other.name for other in header.elements if other is not element]
    if others:
        message = f"elements kept but not used: {', '.join(others)}"
        found.append(Finding("foreign_elements", "info", len(others), message))
    found += [Finding("payload_size", "warning", 1, text) for text in rows.warnings]
    return found


def _value_findings(rows: RowStatistics, limits: ValidationLimits) -> list[Finding]:
    """Findings that are counts of rows with odd values."""
    counts = rows.counts
    table: list[tuple[str, Severity, str]] = [
        ("nan", "error", "rows with NaN"),
        ("infinite", "error", "rows with an infinity other than opacity +Inf or scale -Inf"),
        ("infinite_opacity", "warning", "rows with opacity +Inf, read as fully opaque"),
        ("infinite_scale", "warning", "rows with scale -Inf, read as a size of 0"),
        ("zero_rows", "warning", "rows that are all zeros"),
        ("zero_quaternions", "error", "zero quaternions: no rotation (read as none)"),
        ("duplicates", "warning", "rows equal to an earlier one but for their higher SH"),
        ("too_large", "warning", "rows with a position, size or colour too large to be drawn"),
        ("unnormalised_quaternions", "info", "quaternions not of length 1, normal in training"),
    ]
    found = [Finding(n, severity, counts[n], text) for n, severity, text in table if counts[n]]
    count = len(rows.means)
    if count and counts["too_large"] == count:
        found.append(Finding("not_drawable", "error", count, "no row can be drawn"))
    elif count and rows.opacity.high < _FAINTEST_LOGIT and not counts["infinite_opacity"]:
        message = "nothing can be seen: all opacities are below 1/255"
        found.append(Finding("invisible", "error", count, message))
    return found


def _frame_findings(rows: RowStatistics, limits: ValidationLimits) -> list[Finding]:
    """Findings about where the splats are and how large, from the middle 90 % of the finite rows.

    Extent is the largest side of the box that holds the middle 90 % of the positions by axis.
    """
    if len(rows.means) < 2:
        return []
    middle, extent = middle_and_extent(rows.means)
    if not extent > 0:
        message = "positions have no extent: (nearly) all in one place"
        return [Finding("no_extent", "warning", len(rows.means), message)]
    found = []
    count = int(far_positions(rows.means, middle, extent, limits.outlier_factor).sum())
    if count:
        message = f"positions far outside the others (extent {extent:.3g})"
        found.append(Finding("position_outliers", "warning", count, message))
    count = int((rows.largest_scales < math.log(extent) + math.log(limits.tiny_scale)).sum())
    if count:
        message = f"splats smaller than {limits.tiny_scale:g} of the extent: invisible"
        found.append(Finding("tiny_splats", "info", count, message))
    distance = float(np.linalg.norm(middle))
    if distance > limits.far_factor * extent:
        message = (
            f"the splats are {distance:.3g} from the origin, {distance / extent:.3g} times their "
            "extent: float32 positions are coarse, move them to the origin"
        )
        found.append(Finding("far_from_origin", "warning", len(rows.means), message))
    if not limits.normal_extent[0] <= extent <= limits.normal_extent[1]:
        message = f"an unusual extent of {extent:.3g} units"
        found.append(Finding("unusual_extent", "info", len(rows.means), message))
    return found


def _suspect_findings(rows: RowStatistics, limits: SuspectLimits) -> list[Finding]:
    """Findings that are counts of splats that are probably not of the object's surface."""
    drawable = (np.abs(rows.means) < MAX_MAGNITUDE).all(axis=1)
    drawable &= rows.largest_scales < math.log(MAX_MAGNITUDE)
    total = int(drawable.sum())
    scales = np.exp(rows.scales[drawable])
    opacities = 1 / (1 + np.exp(-rows.opacities[drawable].clip(-80, 80)))
    masks = find_suspects(rows.means[drawable], scales, opacities, limits)
    messages = {
        "floaters": "splats on their own, away from the others",
        "giants": f"splats with a deviation above {limits.giant_size:g} of the object's extent",
        "haze": f"large splats with an opacity below {limits.haze_opacity:g}",
        "needles": f"long splats, more than {limits.needle_ratio:g} times longer than wide",
    }
    return [
        Finding(name, "warning", count, f"{messages[name]} ({100 * count / total:.2g} %)")
        for name, mask in masks.items()
        if (count := int(mask.sum()))
    ]


def _linear_findings(rows: RowStatistics) -> list[Finding]:
    """Findings about values that look as if logit, log or SH conversion had been left out."""
    ranges = (rows.opacity.ends, rows.scale.ends, rows.base.ends)
    found = linear_values(rows.means, rows.largest_scales, *ranges)
    count = len(rows.means)
    return [
        Finding(each.name, "error" if each.is_sure else "warning", count, each.message)
        for each in found
    ]


def _sh_order_findings(rows: RowStatistics, limits: ValidationLimits) -> list[Finding]:
    """Guess whether ``f_rest`` is coefficient-major, which other tools would show discoloured.

    The three channels of one coefficient are strongly correlated in real files (most of what
    depends on the view is light, not colour). So whichever order puts correlated values where it
    expects the channels of one coefficient is the file's.
    """
    sample = rows.higher_sample[np.isfinite(rows.higher_sample).all(axis=1)]
    per_channel = sample.shape[1] // 3
    if len(sample) < limits.min_rows_for_guesses or per_channel == 0:
        return []
    # Splats.sh order puts channels innermost: back to the order in the file
    stored = sample.reshape(-1, per_channel, 3).transpose(0, 2, 1).reshape(len(sample), -1)
    with np.errstate(all="ignore"):
        correlation = np.nan_to_num(np.corrcoef(stored.astype(np.float64), rowvar=False))
    index = np.arange(per_channel)
    as_expected = correlation[index, index + per_channel].mean()
    swapped = correlation[3 * index, 3 * index + 1].mean()
    if swapped < as_expected + limits.sh_order_margin:
        return []
    message = (
        "f_rest looks coefficient-major (r, g, b of each coefficient), expected channel-major: "
        f"correlation between channels {swapped:.2f} against {as_expected:.2f}"
    )
    return [Finding("sh_layout", "warning", len(rows.means), message)]
