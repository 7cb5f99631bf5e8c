"""Where the splat values sit in a vertex record, and moving them in and out of it.

Conventions
-----------
* Schema of the original 3DGS: ``x y z``, ``f_dc_0..2``, ``f_rest_0..``, ``opacity``,
  ``scale_0..2``, ``rot_0..3`` (w, x, y, z), in any order, among any other properties.
* ``f_rest`` is channel-major: all higher coefficients of red, then green, then blue.
* In a record opacities are logits and scales natural logarithms; in ``Splats`` they are not.
* Records are moved in blocks of rows that fit the processor's cache: a column of a large record
  table costs as much memory traffic as the whole table.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from gscomplete.splats.ply_header import Element, PlyError
from gscomplete.splats.record import Splats

BLOCK_ROWS = 2048
"""Rows moved at once: 0.5 MB of records at SH degree 3."""

LOGIT_LIMIT = 20.0
"""Opacities 0 and 1 are written as logits of -20 and 20, which read back as 2e-9 and 1."""

LOG_SCALE_LIMIT = -46.0
"""Scales below 1e-20, zero among them, are written as this logarithm."""

REQUIRED = (
    *("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)
"""Properties without which there are no splats."""

_HIGHER_PER_CHANNEL = {0: 0, 9: 3, 24: 8, 45: 15, 72: 24}


@dataclass(frozen=True, slots=True)
class SplatLayout:
    """Indices of the splat properties within a vertex record."""

    means: tuple[int, ...]  # 3
    sh: tuple[int, ...]  # 3 K: f_dc and f_rest in the order of Splats.sh, channels innermost
    opacity: int
    scales: tuple[int, ...]  # 3
    quaternion: tuple[int, ...]  # 4
    foreign: tuple[str, ...]  # names of all other properties
    integer: tuple[str, ...]  # names of splat properties of an integer type
    dropped_bands: bool  # True when the file has SH above degree 3

    @property
    def coefficients(self) -> int:
        """Number K of SH coefficients per channel that are read."""
        return len(self.sh) // 3


def find_layout(element: Element, path: Path) -> SplatLayout:
    """Find the splat properties of a vertex element.

    Raises:
        PlyError: a property is missing, doubled or a list, or ``f_rest`` has a wrong count.
    """
    names = element.names
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        kind = describe_vertices(names)
        message = (
            f"element vertex: expected the properties {', '.join(REQUIRED)}; "
            f"missing {', '.join(missing)}{kind}"
        )
        none_of_ours = len(missing) > len(REQUIRED) - 4  # at most x, y, z are there
        raise PlyError(path, "not_a_splat_file" if none_of_ours else "missing_property", message)
    rest_count = _count_higher(names)
    if rest_count not in _HIGHER_PER_CHANNEL:
        counts = ", ".join(str(count) for count in _HIGHER_PER_CHANNEL)
        message = f"element vertex: expected {counts} f_rest properties, found {rest_count}"
        raise PlyError(path, "sh_layout", message)
    index = _index_properties(element, path, rest_count)
    per_channel = _HIGHER_PER_CHANNEL[rest_count]
    kept = min(per_channel, 15)
    return SplatLayout(
        means=tuple(index[name] for name in "xyz"),
        sh=tuple(index[f"f_dc_{c}"] for c in range(3))
        + tuple(index[f"f_rest_{c * per_channel + k}"] for k in range(kept) for c in range(3)),
        opacity=index["opacity"],
        scales=tuple(index[f"scale_{i}"] for i in range(3)),
        quaternion=tuple(index[f"rot_{i}"] for i in range(4)),
        foreign=tuple(name for name in names if name not in index),
        integer=tuple(n for n, i in index.items() if element.properties[i].code[0] in "iu"),
        dropped_bands=per_channel > kept,
    )


def _index_properties(element: Element, path: Path, rest_count: int) -> dict[str, int]:
    """Places of the splat properties by name; each must be there once and be a number."""
    names = element.names
    rest_names = [f"f_rest_{i}" for i in range(rest_count)]
    index: dict[str, int] = {}
    for name in (*REQUIRED, *rest_names):
        places = [i for i, found in enumerate(names) if found == name]
        if len(places) != 1:
            message = f"element vertex: property {name}: expected once, found {len(places)} times"
            raise PlyError(path, "missing_property" if not places else "bad_header", message)
        index[name] = places[0]
    for prop in element.properties:
        if prop.count_code is not None:
            message = f"element vertex: property {prop.name}: expected a number, found a list"
            raise PlyError(path, "mistyped_property", message)
    return index


def _count_higher(names: list[str]) -> int:
    """Number of ``f_rest`` properties that the highest index among them implies."""
    found = [name.removeprefix("f_rest_") for name in names if name.startswith("f_rest_")]
    indices = [int(text) for text in found if re.fullmatch("[0-9]{1,9}", text)]
    implied = max(indices, default=-1) + 1
    return implied if implied in _HIGHER_PER_CHANNEL else len(found)


def describe_vertices(names: list[str]) -> str:
    """Say what vertices without splat properties look like; empty when unknown."""
    if "packed_position" in names:
        return " (a SuperSplat compressed PLY)"
    if "red" in names or "diffuse_red" in names:
        return " (it looks like a coloured point cloud or mesh, not splats)"
    if "opacity" not in names and "f_dc_0" not in names:
        return " (it looks like a point cloud or mesh, not splats)"
    return ""


def blocks(count: int) -> Iterator[slice]:
    """Cut ``count`` rows into slices of ``BLOCK_ROWS``."""
    for start in range(0, count, BLOCK_ROWS):
        yield slice(start, min(start + BLOCK_ROWS, count))


def decode(records: NDArray[np.void], layout: SplatLayout) -> Splats:
    """Turn vertex records into splats with activated float32 values.

    Values outside what the activations allow stay recognisable: an opacity of +Inf gives 1, a
    scale of -Inf gives 0, NaN stays NaN. Quaternions are normalised; a zero one becomes (1, 0, 0,
    0), as if it had not been written.

    Args:
        records: [N] rows of ``Element.row_dtype``.
        layout: where the values are.
    """
    count = len(records)
    means = np.empty((count, 3), np.float32)
    quaternions = np.empty((count, 4), np.float32)
    scales = np.empty((count, 3), np.float32)
    opacities = np.empty(count, np.float32)
    sh = np.empty((count, 3 * layout.coefficients), np.float32)
    with np.errstate(all="ignore"):
        for rows in blocks(count):
            table = value_table(records[rows])
            means[rows] = table.take(layout.means, axis=1)
            np.exp(table.take(layout.scales, axis=1), out=scales[rows])
            opacities[rows] = 1 / (1 + np.exp(-table[:, layout.opacity]))
            quaternions[rows] = unit_quaternions(table.take(layout.quaternion, axis=1))
            sh[rows] = table.take(layout.sh, axis=1)
    arrays = (means, quaternions, scales, opacities, sh.reshape(count, layout.coefficients, 3))
    return Splats(*(torch.from_numpy(array) for array in arrays))


def value_table(records: NDArray[np.void]) -> NDArray[np.float32]:  # [B, P]
    """All values of some records as a float32 table; a view where they are stored as one."""
    if _is_uniform(records.dtype):
        return records.view(np.float32).reshape(len(records), -1)
    names = records.dtype.names or ()
    table = np.empty((len(records), len(names)), np.float32)
    for i, name in enumerate(names):
        table[:, i] = records[name]
    return table


def _is_uniform(dtype: np.dtype) -> bool:
    """True when records of this type are float32 numbers in the machine's byte order only."""
    kinds = {dtype[name] for name in dtype.names or ()}
    return kinds == {np.dtype("=f4")}


def unit_quaternions(quaternions: NDArray[np.float32]) -> NDArray[np.float32]:  # [B, 4]
    """Normalise without overflow or underflow; zero quaternions become the identity."""
    columns = np.ascontiguousarray(quaternions.T)
    largest = np.abs(columns).max(axis=0)
    zero = largest == 0
    columns /= np.where(zero, 1, largest)
    columns[0, zero] = 1
    columns /= np.sqrt((columns * columns).sum(axis=0))
    return columns.T


def encode(
    splats: Splats,  # N splats
    layout: SplatLayout,
    dtype: np.dtype,  # Element.row_dtype
) -> Iterator[NDArray[np.void]]:
    """Yield the records of the splats in blocks; foreign properties and missing bands are 0.

    Opacities and scales are clamped so that logits and logarithms are finite (``LOGIT_LIMIT``,
    ``LOG_SCALE_LIMIT``).

    Raises:
        ValueError: a value is NaN or infinite, a scale is negative, an opacity is outside
            [0, 1], or the splats have more SH bands than the records.
    """
    written = 3 * splats.sh.shape[1]
    if written > len(layout.sh):
        raise ValueError(f"encode: {written} SH values per splat, room for {len(layout.sh)}")
    columns = [*layout.means, *layout.scales, layout.opacity, *layout.quaternion]
    columns += layout.sh[:written]
    source = np.full(
        len(dtype.names or ()), len(columns)
    )  # per property: a column of values, or the zeros
    source[columns] = np.arange(len(columns))
    arrays = [value.detach().cpu().numpy() for _, value in splats.fields()]
    names = [name for name, _ in splats.fields()]
    for rows in blocks(len(splats)):
        part = {name: array[rows] for name, array in zip(names, arrays, strict=True)}
        yield _records(_file_values(part).take(source, axis=1), dtype)


def _file_values(part: dict[str, NDArray]) -> NDArray[np.float32]:  # [B, 12 + 3 K]
    """Check one block of splats and turn it into the numbers files hold, a zero column last."""
    for name, value in part.items():
        if not np.isfinite(value).all():
            bad = int((~np.isfinite(value)).sum())
            raise ValueError(f"splats.{name}: expected finite values, found {bad} others")
    if part["scales"].min() < 0:
        raise ValueError("splats.scales: expected values >= 0, found negative ones")
    if part["opacities"].min() < 0 or part["opacities"].max() > 1:
        raise ValueError("splats.opacities: expected values in [0, 1], found others")
    count = len(part["means"])
    opacities = part["opacities"].astype(np.float64)
    with np.errstate(divide="ignore"):
        logits = np.log(opacities) - np.log1p(-opacities)
        logs = np.log(part["scales"])
    columns = [
        part["means"],
        np.maximum(logs, LOG_SCALE_LIMIT),
        np.clip(logits, -LOGIT_LIMIT, LOGIT_LIMIT)[:, None],
        part["quaternions"],
        part["sh"].reshape(count, -1),
        np.zeros((count, 1)),
    ]
    return np.concatenate(columns, axis=1, dtype=np.float32, casting="same_kind")


def _records(table: NDArray[np.float32], dtype: np.dtype) -> NDArray[np.void]:  # [B, P] -> [B]
    """Turn a table of all values into records."""
    if _is_uniform(dtype):
        return table.view(dtype)[:, 0]
    records = np.empty(len(table), dtype)
    for i, name in enumerate(dtype.names or ()):
        records[name] = table[:, i]
    return records
