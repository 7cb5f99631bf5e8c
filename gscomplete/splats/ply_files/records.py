"""Moving splat values out of vertex records and into them, block by block.

Conventions
-----------
* In a record opacities are logits and scales natural logarithms; in ``Splats`` they are not.
* Records are moved in blocks that fit the processor's cache (``threads``): a column of a large
  record table costs as much memory traffic as the whole table. Arrays are allocated once.
* Records of float32 values only, which is what files hold but for rare ones, go through compiled
  loops (``kernels``) when there are enough of them to pay for loading those; all others
  through numpy. Both give the same bits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from gscomplete.splats.ply_files.layout import SplatLayout
from gscomplete.splats.ply_files.threads import Scratch, blocks
from gscomplete.splats.record import Splats
from gscomplete.splats.rotations import unit_quaternions
from gscomplete.util.arrays import Float32Array

LOGIT_LIMIT = 20.0
"""Opacities 0 and 1 are written as logits of -20 and 20, which read back as 2e-9 and 1."""

LOG_SCALE_LIMIT = -46.0
"""Scales below 1e-20, zero among them, are written as this logarithm."""

FEW_ROWS = 8192
"""Up to this many rows numpy is done before the compiled loops would be loaded."""


@dataclass(frozen=True, slots=True, eq=False)
class Decoder:
    """Arrays for N splats, filled in from records in any order and from any thread."""

    layout: SplatLayout
    places: NDArray[np.uint64] | None  # for the compiled loops; None = numpy does it
    means: Float32Array  # [N, 3]
    quaternions: Float32Array  # [N, 4]
    scales: Float32Array  # [N, 3]
    opacities: Float32Array  # [N]
    sh: Float32Array  # [N, 3 K]

    @classmethod
    def for_rows(cls, count: int, layout: SplatLayout, dtype: np.dtype) -> Decoder:
        """Make room for ``count`` splats from records of ``Element.row_dtype``."""
        compiled = count > FEW_ROWS and _is_uniform(dtype)
        places = _places(layout, len(layout.sh)) if compiled else None
        shapes = ((count, 3), (count, 4), (count, 3), (count,), (count, len(layout.sh)))
        return cls(layout, places, *(np.empty(shape, np.float32) for shape in shapes))

    def fill(self, rows: slice, records: NDArray[np.void]) -> None:
        """Turn a block of records into the activated values of some rows.

        Values outside what the activations allow stay recognisable: an opacity of +Inf gives 1, a
        scale of -Inf gives 0, NaN stays NaN. Quaternions are normalised; a zero one becomes
        (1, 0, 0, 0), as if it had not been written.

        Args:
            rows: where the block belongs.
            records: as many rows of ``Element.row_dtype``.
        """
        with np.errstate(all="ignore"):
            if self.places is None:
                self._fill(rows, value_table(records))
            else:
                self._fill_compiled(rows, records, self.places)

    def _fill(self, rows: slice, table: Float32Array) -> None:
        layout = self.layout
        self.means[rows] = table.take(layout.means, axis=1)
        np.exp(table.take(layout.scales, axis=1), out=self.scales[rows])
        self.opacities[rows] = 1 / (1 + np.exp(-table[:, layout.opacity]))
        self.quaternions[rows] = unit_quaternions(table.take(layout.quaternion, axis=1))
        self.sh[rows] = table.take(layout.sh, axis=1)

    def _fill_compiled(
        self, rows: slice, records: NDArray[np.void], places: NDArray[np.uint64]
    ) -> None:
        from gscomplete.splats.ply_files.kernels import split_table

        table = records.view(np.float32).reshape(len(records), -1)
        scales, opacities = self.scales[rows], self.opacities[rows]
        means, quaternions, sh = self.means[rows], self.quaternions[rows], self.sh[rows]
        split_table(table, places, means, quaternions, scales, opacities, sh)
        np.exp(scales, out=scales)
        np.exp(opacities, out=opacities)
        np.add(opacities, 1, out=opacities)
        np.divide(1, opacities, out=opacities)

    def splats(self) -> Splats:
        """Return the splats, on the arrays themselves."""
        sh = self.sh.reshape(len(self.sh), self.layout.coefficients, 3)
        arrays = (self.means, self.quaternions, self.scales, self.opacities, sh)
        return Splats(*(torch.from_numpy(array) for array in arrays))


def _places(layout: SplatLayout, sh_values: int) -> NDArray[np.uint64]:
    """Columns in the order that ``kernels`` expects."""
    places = [*layout.means, *layout.scales, layout.opacity, *layout.quaternion]
    return np.array([*places, *layout.sh[:sh_values]], np.uint64)


@dataclass(frozen=True, slots=True, eq=False)
class Encoder:
    """Turns splats into records; foreign properties and missing bands are 0.

    Opacities and scales are clamped so that logits and logarithms are finite (``LOGIT_LIMIT``,
    ``LOG_SCALE_LIMIT``).
    """

    layout: SplatLayout
    dtype: np.dtype  # Element.row_dtype
    places: NDArray[np.uint64]  # columns in the order that ``kernels`` expects
    compiled: bool
    arrays: dict[str, NDArray]  # the fields of Splats
    scratch: Scratch

    @classmethod
    def of_splats(cls, splats: Splats, layout: SplatLayout, dtype: np.dtype) -> Encoder:
        """Prepare splats for records.

        Raises:
            ValueError: the splats have more SH bands than the records.
        """
        written = 3 * splats.sh.shape[1]
        if written > len(layout.sh):
            raise ValueError(f"encode: {written} SH values per splat, room for {len(layout.sh)}")
        arrays = {name: value.detach().cpu().numpy() for name, value in splats.fields()}
        plain = all(array.dtype == np.float32 for array in arrays.values())
        compiled = plain and len(splats) > FEW_ROWS and _is_uniform(dtype)
        return cls(layout, dtype, _places(layout, written), compiled, arrays, Scratch())

    def __len__(self) -> int:
        """Return the number of splats."""
        return len(self.arrays["means"])

    def blocks(self) -> Iterator[NDArray[np.void]]:
        """Yield the records in blocks, in order.

        Raises:
            ValueError: as ``records``.
        """
        for rows in blocks(len(self), self.dtype.itemsize):
            yield self.records(rows)

    def records(self, rows: slice) -> NDArray[np.void]:  # [B]
        """Return the records of some splats; they last until the thread's next call.

        Raises:
            ValueError: a value is NaN or infinite, a scale is negative, or an opacity is outside
                [0, 1].
        """
        records = self.scratch.records(rows.stop - rows.start, self.dtype)
        for part in blocks(len(records), self.dtype.itemsize):
            first, last = rows.start + part.start, rows.start + part.stop
            values = {name: np.ascontiguousarray(a[first:last]) for name, a in self.arrays.items()}
            _check(values)
            if self.compiled:
                self._fill_compiled(values, records[part])
            else:
                self._fill(values, records[part])
        return records

    def _fill(self, values: dict[str, NDArray], records: NDArray[np.void]) -> None:
        table = _file_values(values)
        for name in self.dtype.names or ():
            records[name] = 0
        for column, place in enumerate(self.places):
            records[f"p{place}"] = table[:, column]

    def _fill_compiled(self, values: dict[str, NDArray], records: NDArray[np.void]) -> None:
        from gscomplete.splats.ply_files.kernels import join_table

        logs, logits = _logarithms(values)
        sh = values["sh"].reshape(len(logits), -1)
        table = records.view(np.float32).reshape(len(records), -1)
        if len(self.places) < table.shape[1]:
            table.fill(0)
        means, quaternions = values["means"], values["quaternions"]
        join_table(means, quaternions, logs, logits.astype(np.float32), sh, self.places, table)


def _check(part: dict[str, NDArray]) -> None:
    """Check one block of splats."""
    for name, value in part.items():
        if not np.isfinite(value).all():
            bad = int((~np.isfinite(value)).sum())
            raise ValueError(f"splats.{name}: expected finite values, found {bad} others")
    if part["scales"].min() < 0:
        raise ValueError("splats.scales: expected values >= 0, found negative ones")
    if part["opacities"].min() < 0 or part["opacities"].max() > 1:
        raise ValueError("splats.opacities: expected values in [0, 1], found others")


def _logarithms(part: dict[str, NDArray]) -> tuple[NDArray, NDArray]:  # [B, 3], [B]
    """Return the clamped logarithms of the scales and logits of the opacities."""
    opacities = part["opacities"].astype(np.float64)
    with np.errstate(divide="ignore"):
        logits = np.log(opacities) - np.log1p(-opacities)
        logs = np.log(part["scales"])
    return np.maximum(logs, LOG_SCALE_LIMIT), np.clip(logits, -LOGIT_LIMIT, LOGIT_LIMIT)


def _file_values(part: dict[str, NDArray]) -> Float32Array:  # [B, 11 + 3 K]
    """Turn one block of splats into the numbers files hold, in the order of ``_places``."""
    logs, logits = _logarithms(part)
    count = len(logits)
    sh = part["sh"].reshape(count, -1)
    columns = [part["means"], logs, logits[:, None], part["quaternions"], sh]
    with np.errstate(over="ignore"):
        table = np.concatenate(columns, axis=1, dtype=np.float32, casting="same_kind")
    if not np.isfinite(table).all():
        raise ValueError("splats: expected values that float32 can hold, found larger ones")
    return table


def value_table(records: NDArray[np.void]) -> Float32Array:  # [B, P]
    """All values of some records as a float32 table; a view where they are stored as one."""
    names = records.dtype.names or ()
    if _is_uniform(records.dtype):
        return records.view(np.float32).reshape(len(records), len(names))
    table = np.empty((len(records), len(names)), np.float32)
    for i, name in enumerate(names):
        table[:, i] = records[name]
    return table


def _is_uniform(dtype: np.dtype) -> bool:
    """True when records of this type are float32 numbers in the machine's byte order only."""
    kinds = {dtype[name] for name in dtype.names or ()}
    return kinds == {np.dtype("=f4")}
