"""Boxes that keep or remove what lies inside them.

Conventions
-----------
* A box is in the frame of the file it cuts, in its units: centre, half extents, and the rotation
  that turns box axes into the file's axes, a unit quaternion (w, x, y, z).
* The first ``keep`` box (or, without any, everything) is the start, wherever it stands; the others
  apply in order: ``keep`` boxes add, ``remove`` boxes take away.
* As text: ``CX,CY,CZ,HX,HY,HZ``, with ``,QW,QX,QY,QZ`` for an oriented box, and led by
  ``remove:`` or, if one likes, ``keep:``. A file of boxes, ``*.txt``, holds one a line.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gscomplete.errors import UserError
from gscomplete.splats.rotations import matrix_rows
from gscomplete.util.arrays import BoolArray, Float64Array

Action = Literal["keep", "remove"]
BOXES_SUFFIX = ".txt"


@dataclass(frozen=True, slots=True)
class CropBox:
    """One oriented box."""

    center: tuple[float, float, float]
    """Centre, file frame."""
    half_extents: tuple[float, float, float]
    """Half the edge lengths along the box's own axes."""
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Rotation of box axes into file axes, wxyz, scaled to unit length here."""
    action: Action = "keep"
    """Whether what lies inside is kept or removed."""

    def __post_init__(self) -> None:
        """Check the numbers and normalise the quaternion.

        Raises:
            ValueError: a number is not finite, an extent is not positive, or the quaternion is 0.
        """
        numbers = (*self.center, *self.half_extents, *self.quaternion)
        if not all(math.isfinite(number) for number in numbers):
            raise ValueError(f"box: expected finite numbers, found {numbers}")
        if min(self.half_extents) <= 0:
            raise ValueError(f"box: expected positive half extents, found {self.half_extents}")
        length = math.sqrt(sum(q * q for q in self.quaternion))
        if length < 1e-9:
            raise ValueError("box: expected a quaternion w,x,y,z that is not 0")
        w, x, y, z = (q / length for q in self.quaternion)
        object.__setattr__(self, "quaternion", (w, x, y, z))

    @property
    def rotation(self) -> Float64Array:  # [3, 3], columns are the box's axes
        """Matrix that turns box axes into file axes."""
        return np.array(matrix_rows(*self.quaternion))

    def contains(self, points: NDArray[np.floating]) -> BoolArray:  # [N, 3] -> [N]
        """Mark the points inside the box or on its faces; points that are not finite are not."""
        local = (np.asarray(points, np.float64) - np.asarray(self.center)) @ self.rotation
        with np.errstate(invalid="ignore"):
            inside: BoolArray = np.all(np.abs(local) <= np.asarray(self.half_extents), 1)
        return inside


def inside_boxes(
    points: NDArray[np.floating],  # [N, 3]
    boxes: Sequence[CropBox],
) -> BoolArray:  # [N]
    """Mark what a list of boxes keeps; no box keeps everything."""
    start = next((box for box in boxes if box.action == "keep"), None)
    kept = np.ones(len(points), np.bool_) if start is None else start.contains(points)
    for box in boxes:
        if box is start:
            continue
        inside = box.contains(points)
        kept = kept | inside if box.action == "keep" else kept & ~inside
    return kept


def parse_box(text: str, option: str = "--box") -> CropBox:
    """Read a box from text (module conventions).

    Raises:
        UserError: the text has another form.
    """
    action, colon, numbers = text.rpartition(":")
    form = "[keep:|remove:]CX,CY,CZ,HX,HY,HZ[,QW,QX,QY,QZ]"
    if colon and action not in ("keep", "remove"):
        raise UserError(f"{option}: expected {form}, found {text!r}")
    try:
        values = [float(word) for word in numbers.split(",")]
        if len(values) not in (6, 10):
            raise ValueError(f"{len(values)} numbers")
        turn = values[6:] or [1.0, 0.0, 0.0, 0.0]
        return CropBox(
            (values[0], values[1], values[2]),
            (values[3], values[4], values[5]),
            (turn[0], turn[1], turn[2], turn[3]),
            "remove" if action == "remove" else "keep",
        )
    except ValueError as error:
        raise UserError(f"{option}: expected {form}, found {text!r} ({error})") from error


def read_boxes(text: str, option: str = "--box") -> list[CropBox]:
    """Read a box from text, or those of a file that the text names.

    Raises:
        UserError: the file cannot be read or holds no box, or a box has another form.
    """
    if not text.endswith(BOXES_SUFFIX):
        return [parse_box(text, option)]
    try:
        lines = Path(text).read_text("utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{option} {text}: cannot be read: {error}") from error
    boxes = [
        parse_box(line.strip(), f"{option} {text}, line {number}")
        for number, line in enumerate(lines, 1)
        if line.strip()
    ]
    if not boxes:
        raise UserError(f"{option} {text}: expected a box a line, found none")
    return boxes


def box_text(box: CropBox) -> str:
    """Write a box as :func:`parse_box` reads it, to a 100,000th of its least half extent."""
    digits = 5 - math.floor(math.log10(min(box.half_extents)))
    words = [f"{round(number, digits):.15g}" for number in (*box.center, *box.half_extents)]
    if box.quaternion != (1.0, 0.0, 0.0, 0.0):
        words += [f"{number:.6g}" for number in box.quaternion]
    prefix = "remove:" if box.action == "remove" else ""
    return prefix + ",".join(words)
