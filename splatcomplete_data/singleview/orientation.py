"""Which pixels of a photo with an EXIF orientation go with its depth, and which way is up.

Conventions
-----------
* Depth comes from the photo's stored pixels (sensors) or from the photo as it is given (networks
  that turn it first). The aspect ratio tells which: that of the depth, or the nearer of two.
* As shown, the photo is turned and up is -y of the camera. As stored, nothing is turned, and up is
  where a viewer of the photo sees it.
* Where the aspect ratio does not tell (a square photo, half a turn), stored pixels are assumed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from PIL import Image, ImageOps

from gscomplete.errors import UserError
from gscomplete.views import UpAxis
from splatcomplete_data.pictures import SHOWN_AXES, UPRIGHT, orientation

_MOST_MISFIT = 0.02
"""Aspect ratios may differ by this share: sizes are rounded."""
_QUARTER_TURNS = (5, 6, 7, 8)
"""Orientations that swap width and height."""
_CAMERA_AXES: dict[tuple[int, int], UpAxis] = {
    (0, -1): "-Y",
    (0, 1): "Y",
    (1, 0): "X",
    (-1, 0): "-X",
}
"""Camera axes (x right, y down) of steps in the stored pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class FittingPicture:
    """A picture whose pixels are those of the depth, but for their size."""

    picture: Image.Image
    up: UpAxis
    """The camera's axis that points up."""
    notes: tuple[str, ...] = ()


def fitting_picture(picture: Image.Image, width: int, height: int, path: Path) -> FittingPicture:
    """Turn a photo by its EXIF orientation where that makes it fit its depth.

    Args:
        picture: the photo, as stored.
        width: the depth's width.
        height: the depth's height.
        path: the file named in errors.

    Raises:
        UserError: it has another aspect ratio than the depth, however it is turned.
    """
    tag = orientation(picture)
    stored, turned = _misfit(*picture.size, width, height), _misfit(*picture.size, height, width)
    shown = turned if tag in _QUARTER_TURNS else stored
    if min(stored, shown) > _MOST_MISFIT:
        message = f"expected the depth's aspect ratio ({width} x {height}), found "
        message += f"{picture.width} x {picture.height} pixels"
        if tag in _QUARTER_TURNS:
            message += f", or {picture.height} x {picture.width} turned as its EXIF says"
        elif turned <= _MOST_MISFIT:
            message += "; it fits if turned by 90 degrees, but has no EXIF rotation (perhaps lost "
            message += "when it was saved again): turn it"
        raise UserError(f"{path}: {message}")
    if tag == UPRIGHT:
        return FittingPicture(picture, "-Y")
    name = f"the photo's EXIF rotation ({tag})"
    if shown < stored:
        note = f"{name} is applied, as the turned photo has the depth's aspect ratio"
        return FittingPicture(ImageOps.exif_transpose(picture), "-Y", (note,))
    up = _CAMERA_AXES[SHOWN_AXES[tag][1]]
    if stored < shown:
        note = f"{name} is not applied, as the stored pixels have the depth's aspect ratio"
    else:
        note = f"{name} is not applied: the depth fits with and without it, and is assumed to be "
        note += "that of the stored pixels"
    return FittingPicture(picture, up, (f"{note}. By it, up is {up} of the camera axes",))


def _misfit(width: int, height: int, depth_width: int, depth_height: int) -> float:
    """Return the share by which two aspect ratios differ."""
    return abs(width / height / (depth_width / depth_height) - 1.0)
