"""The object frame: z up, centred on the object, largest side 1.

Conventions
-----------
* The file frame is whatever the splat file uses; ``up`` names the file axis that points up.
* ``object point = R_up (file point - center_file) / size_file``, so lengths in the object frame are
  multiples of the object's largest side. Arithmetic is float64.
* R_up is the shortest rotation that lifts the named axis to +z, about x wherever possible:

  ====  =======================  ==================
  up    object (x, y, z) =       rotation
  ====  =======================  ==================
  Z     file ( x,  y,  z)        none
  -Z    file ( x, -y, -z)        180 degrees about x
  Y     file ( x, -z,  y)        90 degrees about x (the usual glTF reading)
  -Y    file ( x,  z, -y)        -90 degrees about x
  X     file (-z,  y,  x)        -90 degrees about y
  -X    file ( z,  y, -x)        90 degrees about y
  ====  =======================  ==================

* ``up`` may also be a direction, as "X,Y,Z" in file axes of any length. R_up is then that of the
  nearest axis, followed by the shortest rotation that lifts the direction to +z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.splats.filters import near_rows
from gscomplete.splats.record import Splats
from gscomplete.splats.transform import Similarity
from gscomplete.util import jsonio

UpAxis = str
"""The file axis that points up, X, Y, Z, -X, -Y or -Z, or a direction "X,Y,Z" in file axes."""

FrameOrigin = Literal["truth", "guess", "given"]
"""Whether centre and size come from the complete object, a guess from the part, or the user. If the
user gave one of the two, this is where the other comes from."""

GivenOfFrame = Literal["center", "size"]
"""What the user gave of a frame."""

_OBJECT_ROWS: dict[str, tuple[tuple[float, float, float], ...]] = {
    "Z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-Z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "Y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-Y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "X": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "-X": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
}


def up_rotation(up: UpAxis) -> Tensor:  # [3, 3]
    """Return the proper rotation (float64) that takes file axes to z-up axes.

    Args:
        up: axis or direction of the file that points up.

    Returns:
        [3, 3] with determinant 1; a column vector of the file times this is z up.

    Raises:
        ValueError: ``up`` is neither one of the six axes nor a direction.
    """
    if isinstance(up, str) and up in _OBJECT_ROWS:
        return torch.tensor(_OBJECT_ROWS[up], dtype=torch.float64, device="cpu")
    direction = _parsed_direction(up)
    axes = {name: np.array(rows[2]) for name, rows in _OBJECT_ROWS.items()}
    nearest = max(axes, key=lambda name: float(axes[name] @ direction))
    rows = np.array(_OBJECT_ROWS[nearest], np.float64)
    x, y, z = rows @ direction  # unit, z > 0
    about, cosine = np.array([y, -x, 0.0]), z
    cross = np.array([[0.0, 0.0, about[1]], [0.0, 0.0, -about[0]], [-about[1], about[0], 0.0]])
    lift = np.eye(3) + cross + cross @ cross / (1.0 + cosine)
    return torch.from_numpy(lift @ rows)


def _parsed_direction(up: str) -> np.ndarray:  # [3] unit
    """Parse a direction.

    Raises:
        ValueError: it is none.
    """
    try:
        direction = np.array([float(part) for part in up.split(",")])
    except (AttributeError, ValueError):  # of what is no text
        direction = np.zeros(0)
    length = float(np.linalg.norm(direction))
    if direction.shape != (3,) or not 1e-12 < length < math.inf:
        raise ValueError(
            f"up: expected one of {', '.join(_OBJECT_ROWS)} or a direction X,Y,Z, found {up!r}"
        )
    return direction / length


def parse_up(text: str | None) -> UpAxis | None:
    """Check what a user gives for up.

    Args:
        text: X, Y, Z, -X, -Y, -Z or a direction X,Y,Z; None = nothing was given.

    Returns:
        The same, checked.

    Raises:
        UserError: it is neither an axis nor a direction.
    """
    if text is not None:
        try:
            up_rotation(text)
        except ValueError as error:
            raise UserError(f"--{error}") from None
    return text


def axis_direction(up: UpAxis) -> tuple[float, float, float]:
    """Return the unit vector, in file axes, of the axis that points up.

    Args:
        up: axis of the file that points up, such as ``-Y``.

    Returns:
        x, y, z.
    """
    x, y, z = up_rotation(up)[2].tolist()
    return (x, y, z)


@dataclass(frozen=True, slots=True)
class ObjectFrame:
    """How the object frame lies in the file frame."""

    up: UpAxis
    """File axis that points up."""
    center_file: tuple[float, float, float]
    """Object-frame origin, in file coordinates."""
    size_file: float
    """Length in file units that is 1 in the object frame (the object's largest side)."""

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ValueError: an unknown axis, a centre that is not three finite numbers, or a size that
                is not positive, or not finite, or whose inverse is not.
        """
        up_rotation(self.up)
        if len(self.center_file) != 3 or not all(math.isfinite(c) for c in self.center_file):
            raise ValueError(
                f"center_file: expected three finite numbers, found {self.center_file}"
            )
        if not (0 < self.size_file < math.inf and 1 / self.size_file < math.inf):
            raise ValueError(f"size_file: expected a positive number, found {self.size_file}")

    @classmethod
    def from_z_up(
        cls, up: UpAxis, center_z_up: tuple[float, float, float], size_file: float
    ) -> ObjectFrame:
        """Build the frame from a centre given in z-up file units (``up_rotation`` applied)."""
        center_in_axes = torch.tensor(center_z_up, dtype=torch.float64, device="cpu")
        center = up_rotation(up).T @ center_in_axes
        x, y, z = center.tolist()
        return cls(up, (x, y, z), float(size_file))

    @classmethod
    def about(cls, splats: Splats, up: UpAxis) -> ObjectFrame:
        """Build the frame of splats taken as the complete object.

        Its box is that of the middle 99.9 % of their centres along every axis, since trained splats
        have floaters. Its size is at least the median of the splats' own, so that a single one has
        a frame too and one that is far too large does not shrink the others to a dot. Splats
        without any extent have a frame of size 1.
        """
        rotated = splats.means.double() @ up_rotation(up).T
        low, high = np.quantile(rotated.numpy(), [0.0005, 0.9995], axis=0)
        x, y, z = ((low + high) / 2).tolist()
        size = max(float((high - low).max()), splats.typical_size)
        return cls.from_z_up(up, (x, y, z), size or 1.0)

    @classmethod
    def without_floaters(cls, splats: Splats, up: UpAxis) -> ObjectFrame:
        """Build the frame of what can be drawn of a file: as ``about``, of any number of floaters.

        The middle 99.9 % of a small file hold one or two of them already.
        """
        return cls.about(splats.select(near_rows(splats)[0]), up)

    def count_outside(self, splats: Splats, reach: float) -> int:
        """Count the centres further than ``reach`` sizes from the frame's along any of its axes."""
        placed = self.object_from_file.apply(splats.means.double())
        return int((placed.abs().amax(dim=1) > reach).sum())

    @property
    def object_from_file(self) -> Similarity:
        """Similarity that takes file coordinates to object coordinates."""
        rotation = up_rotation(self.up)
        center = torch.tensor(self.center_file, dtype=torch.float64, device="cpu")
        return Similarity(1.0 / self.size_file, rotation, -(rotation @ center) / self.size_file)

    @property
    def file_from_object(self) -> Similarity:
        """Similarity that takes object coordinates to file coordinates."""
        center = torch.tensor(self.center_file, dtype=torch.float64, device="cpu")
        return Similarity(self.size_file, up_rotation(self.up).T.contiguous(), center)

    def to_json(self) -> dict[str, Any]:
        """Return the frame as plain JSON values."""
        return jsonio.to_json(self)

    @classmethod
    def from_json(cls, data: Any, source: str) -> ObjectFrame:
        """Read the frame from plain JSON values; ``source`` names the file in errors.

        Raises:
            UserError: a field is missing, unknown or wrong.
        """
        return jsonio.from_json(cls, data, source)
