"""One pass over the vertex records of a splat file: counts of odd rows, and what ranges need.

Conventions
-----------
* Values are those the file holds (logits, logarithms, raw quaternions), as float32.
* Rows are read in blocks; per row only position, log scales, opacity logit and a hash are kept.
* A row with a NaN or an infinity takes part in the counts, but not in ranges and quantiles.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gscomplete.splats.filters import MAX_COEFFICIENT, MAX_MAGNITUDE
from gscomplete.splats.ply_files.header import Element, PlyHeader
from gscomplete.splats.ply_files.layout import SplatLayout
from gscomplete.splats.ply_files.payload import payload_warnings, stream_records
from gscomplete.splats.ply_files.records import value_table
from gscomplete.util.arrays import BoolArray, Float32Array

_BLOCK_ROWS = 8192
_SH_SAMPLE_ROWS = 20_000
_HASH_FACTOR = np.uint64(0x9E3779B97F4A7C15)  # odd, bits well spread (2^64 / golden ratio)

COUNTS = (
    "nan",
    "infinite",
    "infinite_opacity",
    "infinite_scale",
    "too_large",
    "zero_rows",
    "zero_quaternions",
    "unnormalised_quaternions",
    "duplicates",
)
"""Names of the row counts."""


@dataclass(slots=True)
class Range:
    """Smallest and largest of the values seen."""

    low: float = float("inf")
    high: float = float("-inf")

    @property
    def ends(self) -> tuple[float, float]:
        """Smallest and largest value."""
        return self.low, self.high

    def add(self, values: Float32Array) -> None:
        """Widen the range to some values."""
        if values.size:
            self.low = min(self.low, float(values.min()))
            self.high = max(self.high, float(values.max()))


@dataclass(slots=True)
class RowStatistics:
    """What one pass over the rows gives."""

    warnings: tuple[str, ...]
    counts: Counter[str] = field(default_factory=Counter)  # by the names in COUNTS
    opacity: Range = field(default_factory=Range)  # of the finite rows, as are all below
    scale: Range = field(default_factory=Range)
    base: Range = field(default_factory=Range)  # f_dc
    means: Float32Array = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    scales: Float32Array = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    opacities: Float32Array = field(default_factory=lambda: np.zeros(0, np.float32))
    higher_sample: Float32Array = field(  # [M, 3 (K - 1)] in the order of Splats.sh
        default_factory=lambda: np.zeros((0, 0), np.float32)
    )

    @property
    def largest_scales(self) -> Float32Array:  # [N]
        """Logarithm of every splat's largest standard deviation."""
        return self.scales.max(axis=1, initial=-np.inf)

    def bounds(self) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        """Corners of the finite positions, None without any."""
        if not len(self.means):
            return None
        low, high = self.means.min(axis=0), self.means.max(axis=0)
        return tuple(low.tolist()), tuple(high.tolist())


def gather_statistics(
    path: Path,
    header: PlyHeader,
    element: Element,
    layout: SplatLayout,
    quaternion_tolerance: float,
) -> RowStatistics:
    """Read the records once and gather what validation needs.

    Args:
        path: the file.
        header: its header.
        element: its vertex element.
        layout: where the values are.
        quaternion_tolerance: largest difference of a length from 1 that counts as unit.

    Raises:
        PlyError: the payload is truncated or cannot be parsed.
    """
    result = RowStatistics(payload_warnings(path, header, element))
    columns = [*layout.means, *layout.sh[:3], layout.opacity, *layout.scales, *layout.quaternion]
    step = max(1, element.count // _SH_SAMPLE_ROWS)
    means, scales, opacities, hashes, samples = [], [], [], [], []
    with np.errstate(all="ignore"):
        for records in stream_records(path, header, element, _BLOCK_ROWS):
            table = value_table(records)
            values = table.take(columns, axis=1)
            higher = table.take(layout.sh[3:], axis=1)
            finite = _count_rows(values, higher, quaternion_tolerance, result.counts)
            zero = ~values.any(axis=1)
            result.counts["zero_rows"] += int(zero.sum())
            hashes.append(hash_rows(values[~zero]))
            kept = values[finite]
            means.append(kept[:, :3])
            result.base.add(kept[:, 3:6])
            result.opacity.add(kept[:, 6])
            result.scale.add(kept[:, 7:10])
            scales.append(kept[:, 7:10])
            opacities.append(kept[:, 6])
            samples.append(higher[::step].copy())
    if means:
        result.means = np.concatenate(means)
        result.scales = np.concatenate(scales)
        result.opacities = np.concatenate(opacities)
        result.higher_sample = np.concatenate(samples)
        result.counts["duplicates"] = _count_repeats(np.concatenate(hashes))
    return result


def _count_rows(
    values: Float32Array,  # [B, 14]: mean, f_dc, opacity, scales, quaternion
    higher: Float32Array,  # [B, 3 (K - 1)]: f_rest
    quaternion_tolerance: float,
    counts: Counter[str],
) -> BoolArray:  # [B]
    """Count odd rows of a block; return which rows are finite throughout."""
    opacity, scales, quaternions = values[:, 6], values[:, 7:10], values[:, 10:]
    large = (np.abs(values[:, :3]) >= MAX_MAGNITUDE).any(axis=1)
    large |= (scales >= np.log(MAX_MAGNITUDE)).any(axis=1)
    large |= (np.abs(values[:, 3:6]) >= MAX_COEFFICIENT).any(axis=1)
    large |= (np.abs(higher) >= MAX_COEFFICIENT).any(axis=1)
    usual, usual_higher = np.isfinite(values), np.isfinite(higher).all(axis=1)
    finite: BoolArray = np.logical_and(usual.all(axis=1), usual_higher)
    counts["too_large"] += int((large & finite).sum())
    if not finite.all():
        nan = np.isnan(values).any(axis=1) | np.isnan(higher).any(axis=1)
        opaque, flat = opacity == np.inf, scales == -np.inf
        usual[:, 6] |= opaque
        usual[:, 7:10] |= flat
        counts["nan"] += int(nan.sum())
        counts["infinite"] += int((~(usual.all(axis=1) & usual_higher) & ~nan).sum())
        counts["infinite_opacity"] += int(opaque.sum())
        counts["infinite_scale"] += int(flat.any(axis=1).sum())
    zero = ~quaternions.any(axis=1)
    lengths = np.sqrt(np.square(quaternions, dtype=np.float64).sum(axis=1))
    off = (np.abs(lengths - 1) > quaternion_tolerance) & ~zero & np.isfinite(lengths)
    counts["zero_quaternions"] += int(zero.sum())
    counts["unnormalised_quaternions"] += int(off.sum())
    return finite


def hash_rows(values: Float32Array) -> NDArray[np.uint64]:  # [B, C] -> [B]
    """Hash each row's bits; different rows agree with a chance of about 2^-64."""
    columns = np.ascontiguousarray(values.T).view(np.uint32)
    result = np.zeros(len(values), np.uint64)
    for column in columns:
        result ^= column
        result *= _HASH_FACTOR
        result ^= result >> np.uint64(32)
    return result


def _count_repeats(hashes: NDArray[np.uint64]) -> int:
    """Number of entries equal to another one counted before."""
    hashes.sort()
    return int((hashes[1:] == hashes[:-1]).sum())
