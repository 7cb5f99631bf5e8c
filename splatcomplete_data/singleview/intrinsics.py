"""Find a picture's pinhole intrinsics: options, a file, the depth file, EXIF, a field of view.

Conventions
-----------
* ``Intrinsics`` are in pixels of an image of ``width x height``; pixel centres at +0.5. JSON of
  Open3D, ROS and RealSense has them at whole numbers: its principal point is shifted by half a
  pixel. Of other files the convention is not known, and theirs, as the user's, is taken as it is.
* A principal point outside the picture is refused: it is that of a picture of another size.
* A 3 x 3 matrix is read row by row, or column by column where it then has the form of one.
* Order of trust: options, file, the depth file's own, EXIF, a field of view. Without any of them
  it is an error: a scale is never guessed silently.
"""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gscomplete.errors import UserError
from gscomplete.util.arrays import Float64Array

_EXIF_FOCAL_35MM = 41989
_EXIF_IFD = 0x8769
_WIDTH_35MM = 36.0
_MATRIX_KEYS = ("intrinsic_matrix", "K", "k")
"""Of Open3D; Record3D and ROS 1; ROS 2."""
_WHOLE_PIXEL_KEYS = ({"intrinsic_matrix"}, {"ppx", "ppy"}, {"K", "D"}, {"k", "d"})
"""What JSON of Open3D, RealSense, ROS 1 and ROS 2 has: their pixel centres are whole numbers."""


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole camera's numbers."""

    focal_x_px: float
    focal_y_px: float
    center_x_px: float
    center_y_px: float
    width: int
    height: int
    origin: str
    """Where they come from, for the record."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            UserError: a focal length is not positive and finite, or the centre is not within the
                picture.
        """
        numbers = (self.focal_x_px, self.focal_y_px, self.center_x_px, self.center_y_px)
        if not all(math.isfinite(n) for n in numbers) or min(numbers[:2]) <= 0:
            raise UserError(
                f"intrinsics ({self.origin}): expected positive focal lengths and a finite "
                f"centre, found {numbers}"
            )
        if not (0 < self.center_x_px < self.width and 0 < self.center_y_px < self.height):
            raise UserError(
                f"intrinsics ({self.origin}): expected a principal point within the picture of "
                f"{self.width} x {self.height} pixels, found {self.center_x_px:g}, "
                f"{self.center_y_px:g}; they may be those of another resolution"
            )

    def summary(self) -> str:
        """Say for people what they are."""
        return (
            f"intrinsics from {self.origin}: fx {self.focal_x_px:.5g}, fy {self.focal_y_px:.5g}, "
            f"cx {self.center_x_px:.5g}, cy {self.center_y_px:.5g} px of {self.width} x "
            f"{self.height}"
        )

    def shifted(self, pixels: float) -> Intrinsics:
        """Return the intrinsics with the principal point so much further right and down."""
        x, y = self.center_x_px + pixels, self.center_y_px + pixels
        return dataclasses.replace(self, center_x_px=x, center_y_px=y)

    def resized(self, width: int, height: int) -> Intrinsics:
        """Return the intrinsics of the same picture at another size.

        Raises:
            UserError: the aspect ratio differs by more than 2 %.
        """
        x, y = width / self.width, height / self.height
        if abs(x / y - 1.0) > 0.02:
            raise UserError(
                f"intrinsics ({self.origin}): expected the aspect ratio of the depth, {width} x "
                f"{height} pixels, found that of {self.width} x {self.height}"
            )
        return Intrinsics(
            self.focal_x_px * x,
            self.focal_y_px * y,
            self.center_x_px * x,
            self.center_y_px * y,
            width,
            height,
            self.origin,
        )


def from_numbers(
    focal: list[float] | None,
    center: list[float] | None,
    fov_deg: float | None,
    width: int,
    height: int,
) -> Intrinsics | None:
    """Build intrinsics from options; None when none is given.

    Args:
        focal: f, or fx and fy, or fx, fy, cx and cy.
        center: cx and cy.
        fov_deg: horizontal field of view.
        width: image width.
        height: image height.

    Raises:
        UserError: there are other numbers of numbers, both a focal length and a field of view or
            two principal points are given, the field of view is out of range, or a principal point
            comes alone.
    """
    if focal is None and fov_deg is None:
        if center is not None:
            raise UserError("--center-px: expected --focal or --fov with it, found neither")
        return None
    if focal is not None and fov_deg is not None:
        raise UserError("--focal, --fov: expected one of them, found both")
    if fov_deg is not None:
        if not 1 <= fov_deg <= 175:
            raise UserError(f"--fov: expected 1 to 175 degrees, found {fov_deg:g}")
        length = 0.5 * width / math.tan(math.radians(fov_deg) / 2)
        focal = [length, length]
    assert focal is not None
    if len(focal) == 4:
        if center is not None:
            raise UserError("--focal, --center-px: expected one principal point, found two")
        focal, center = focal[:2], focal[2:]
    if len(focal) not in (1, 2):
        raise UserError(f"--focal: expected F, FX,FY or FX,FY,CX,CY; found {len(focal)} numbers")
    middle = center or [width / 2, height / 2]
    fx, fy = focal[0], focal[-1]
    return Intrinsics(fx, fy, middle[0], middle[1], width, height, "options")


def from_matrix(
    matrix: Float64Array,  # [3, 3]
    width: int,
    height: int,
    origin: str,
) -> Intrinsics:
    """Build intrinsics from a camera matrix, given row by row or column by column.

    Raises:
        UserError: it is no camera matrix.
    """
    if (matrix[:2, 2] == 0).all():
        matrix = matrix.T  # Open3D and Record3D write column by column
    if not np.allclose(matrix[2], (0.0, 0.0, 1.0)):
        rows = "; ".join(" ".join(f"{value:g}" for value in row) for row in matrix)
        raise UserError(f"intrinsics ({origin}): expected fx 0 cx; 0 fy cy; 0 0 1, found {rows}")
    return Intrinsics(
        float(matrix[0, 0]),
        float(matrix[1, 1]),
        float(matrix[0, 2]),
        float(matrix[1, 2]),
        width,
        height,
        origin,
    )


def read_intrinsics(path: Path, width: int, height: int) -> Intrinsics:
    """Read an intrinsics file: JSON (``_from_json``), four numbers as text, or a 3 x 3 matrix.

    Args:
        path: the file.
        width: image width assumed where the file names none.
        height: image height assumed where the file names none.

    Raises:
        UserError: it cannot be read, or names no intrinsics.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: intrinsics: cannot read it ({error})") from error
    try:
        data: Any = json.loads(text)
    except (ValueError, RecursionError):  # no JSON, or numbers and nesting that cannot be held
        data = None
    try:
        if isinstance(data, dict):
            found = _from_json(data, path, width, height)
            is_whole = any(keys <= data.keys() for keys in _WHOLE_PIXEL_KEYS)
            return found.shifted(0.5) if is_whole else found
        words = [float(word) for word in text.replace(",", " ").split()]
        if len(words) == 9:
            return from_matrix(np.array(words).reshape(3, 3), width, height, path.name)
        if len(words) == 4:
            return Intrinsics(words[0], words[1], words[2], words[3], width, height, path.name)
    except (ValueError, TypeError, KeyError, IndexError, OverflowError) as error:
        raise UserError(f"{path}: intrinsics: malformed ({error})") from error
    raise UserError(f"{path}: intrinsics: expected JSON, 4 numbers (fx fy cx cy) or a 3 x 3 matrix")


def _from_json(data: dict[str, Any], path: Path, width: int, height: int) -> Intrinsics:
    """Read a matrix, or fx, fy, cx, cy, also by nerfstudio's and RealSense's names for them."""
    w = int(data.get("width", data.get("w", width)))
    h = int(data.get("height", data.get("h", height)))
    key = next((name for name in _MATRIX_KEYS if data.get(name) is not None), None)
    if key is not None:
        numbers = np.array(data[key], np.float64).ravel()
        if numbers.size != 9:
            raise ValueError(f"{key}: expected 9 numbers")
        return from_matrix(numbers.reshape(3, 3), w, h, path.name)

    def first(*names: str) -> float | None:
        return next((float(data[name]) for name in names if name in data), None)

    fx, fy = first("fx", "fl_x"), first("fy", "fl_y")
    cx, cy = first("cx", "ppx"), first("cy", "ppy")
    if fx is None:
        raise ValueError(f"expected a matrix or fx, fy, cx, cy; found {', '.join(data)}")
    origin = path.name
    if cx is None or cy is None:
        cx, cy, origin = w / 2, h / 2, f"{origin}, which has no principal point (the middle)"
    return Intrinsics(fx, fx if fy is None else fy, cx, cy, w, h, origin)


def from_exif(image: Image.Image) -> Intrinsics | None:
    """Read the 35 mm equivalent focal length of a photo; None when it has none."""
    tags = image.getexif()
    value = tags.get_ifd(_EXIF_IFD).get(_EXIF_FOCAL_35MM) or tags.get(_EXIF_FOCAL_35MM)
    try:
        focal_mm = float(value) if value is not None else 0.0
    except (TypeError, ValueError):
        return None
    if not 5 <= focal_mm <= 2000:
        return None
    width, height = image.size
    focal = focal_mm / _WIDTH_35MM * max(width, height)
    return Intrinsics(focal, focal, width / 2, height / 2, width, height, "EXIF")
