"""Cut an object out of a splat file: the kept records are copied byte for byte.

Conventions
-----------
* Boxes are in the file's frame (``boxes``); nothing is moved, harmonics are untouched.
* ``kept_rows`` returns a mask and counts for each reason to drop; ``write_rows`` copies records.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gscomplete.errors import UserError
from gscomplete.splats import usable_rows
from gscomplete.splats.ply import SplatFile
from gscomplete.util.arrays import BoolArray
from gscomplete.util.atomic import atomic_path
from splatcomplete_data.cuts.boxes import CropBox, inside_boxes


def kept_rows(
    source: SplatFile, boxes: Sequence[CropBox]
) -> tuple[BoolArray, dict[str, int]]:  # [N]
    """Mark the splats that boxes keep and that can be drawn.

    Raises:
        UserError: nothing is kept; the message says where the splats are.
    """
    usable, reasons = usable_rows(source.splats)
    points = source.splats.means.numpy()
    mask = usable.numpy().copy()
    inside = inside_boxes(points, boxes)
    outside = int((mask & ~inside).sum())
    if outside:
        reasons = {**reasons, "outside_boxes": outside}
    mask &= inside
    if not mask.any():
        where = "there are no splats that can be drawn"
        if usable.any():
            low, high = np.quantile(points[usable.numpy()], [0.01, 0.99], axis=0)
            where = f"98 % of the splats lie within {_triple(low)} and {_triple(high)}"
        raise UserError(f"{source.path}: the boxes keep none of {source.n_rows} splats; {where}")
    return mask, reasons


def write_rows(path: Path, source: SplatFile, mask: BoolArray) -> None:  # [N]
    """Write the marked records of a file, byte for byte, with its header and other elements.

    Raises:
        UserError: the file cannot be written.
    """
    header, element, payload = source.header, source.element, source.payload
    lines = list(header.lines)
    count = int(mask.sum())
    lines[element.line] = f"element {element.name} {count}".encode() + header.newline
    if header.format == "ascii":
        rows = payload.records.tobytes().splitlines(keepends=True)
        kept = b"".join(row for row, keep in zip(rows, mask, strict=True) if keep)
    else:
        kept = payload.records.reshape(len(mask), -1)[mask].tobytes()
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(b"".join(lines))
        stream.write(payload.before)
        stream.write(kept)
        stream.write(payload.after)


def _triple(point: NDArray[np.floating]) -> str:  # [3]
    """Write a point as text."""
    return ",".join(f"{value:.4g}" for value in point)
