"""What readers of pictures share: size limits, errors, EXIF, pictures of 16 bits, and masks.

Conventions
-----------
* Masks are uint8 [H, W]: 255 shows the object, or counts; 0 does not.
* A mask file is taken from its alpha channel where that varies (somewhere it is not
  opaque; editors add an opaque one), else through the brightest of its channels.
* The largest number tells what white is: of a mask that holds nothing above 1 it is 1, of one up
  to 255 it is 255, beyond that 65535.
* Of photos and textures of integers wider than 8 bits, white is 65535; of floats it is as of masks.
"""

from __future__ import annotations

import contextlib
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image

from gscomplete.errors import UserError

UNREADABLE = (OSError, ValueError, SyntaxError, Image.DecompressionBombError)
"""What Pillow raises for pictures that are missing, damaged, of no known kind, or too large."""
MAX_PIXELS = 2**29
"""Pictures with more are refused: photos and textures have up to 2**28, 16384 x 16384."""
_WIDE_MODES = ("I", "F", "I;16", "I;16B", "I;16L", "I;16N")
"""Modes of more than 8 bits, which Pillow's conversions cut off at 255."""
UPRIGHT = 1
SHOWN_AXES = {
    UPRIGHT: ((1, 0), (0, -1)),
    2: ((-1, 0), (0, -1)),
    3: ((-1, 0), (0, 1)),
    4: ((1, 0), (0, 1)),
    5: ((0, 1), (-1, 0)),
    6: ((0, -1), (-1, 0)),
    7: ((0, -1), (1, 0)),
    8: ((0, 1), (1, 0)),
}
"""By EXIF orientation: what a viewer shows as right and as up, as steps in the stored pixels."""


def orientation(image: Image.Image) -> int:
    """Return a picture's EXIF orientation, a key of ``SHOWN_AXES``; without one it is upright."""
    tag = UPRIGHT
    with contextlib.suppress(*UNREADABLE):
        tag = image.getexif().get(ExifTags.Base.Orientation, UPRIGHT)
    return tag if tag in SHOWN_AXES else UPRIGHT


def allow_large_pictures() -> None:
    """Have this process open pictures of up to ``MAX_PIXELS``, and no word on those below.

    Pillow stops at a third of that, to guard servers. For applications, not for libraries.
    """
    Image.MAX_IMAGE_PIXELS = MAX_PIXELS // 2  # Pillow warns from here on, and refuses from twice
    warnings.simplefilter("ignore", Image.DecompressionBombWarning)


def read_mask(path: Path) -> NDArray[np.uint8]:  # [H, W]
    """Read a mask (module conventions).

    Raises:
        UserError: it cannot be read.
    """
    try:
        with Image.open(path) as image:
            values = _mask_values(image)
    except UNREADABLE as error:
        raise UserError(f"{path}: mask: cannot read it as a picture ({error})") from error
    return _bytes(values, _white(values))


def eight_bits(image: Image.Image) -> Image.Image:
    """Return a photo or texture in a mode of 8 bits a channel, which Pillow converts correctly.

    Args:
        image: of any mode; greys of more bits are scaled so that their white (module conventions;
            of integers beyond 65535 the largest) becomes 255, others are returned as they are.
    """
    if image.mode not in _WIDE_MODES:
        return image
    values = np.nan_to_num(np.asarray(image))
    is_float = np.issubdtype(values.dtype, np.floating)
    white = _white(values) if is_float else max(65535, int(values.max(initial=0)))
    grey = _bytes(values, white)
    clear = image.info.get("transparency")
    if isinstance(clear, int):  # the grey that a PNG shows as transparent
        grey = np.dstack([grey, np.where(values == clear, np.uint8(0), np.uint8(255))])
    return Image.fromarray(grey)


def _white(values: NDArray[Any]) -> int:
    """Return which number stands for white: the least usual one that no value is above."""
    largest = values.max(initial=0)
    return next((top for top in (1, 255) if largest <= top), 65535)


def _bytes(values: NDArray[Any], white: int) -> NDArray[np.uint8]:
    """Scale numbers so that white becomes 255, rounding to nearest."""
    if white == 255 and values.dtype == np.uint8:
        return np.asarray(values)
    return np.clip(np.rint(values * (255.0 / white)), 0, 255).astype(np.uint8)


def _mask_values(image: Image.Image) -> NDArray[Any]:  # [H, W]
    """Return the numbers of a mask file that hold the mask."""
    if image.mode in _WIDE_MODES:
        return np.nan_to_num(np.asarray(image))
    if "A" in image.getbands() or "transparency" in image.info:
        pixels = np.asarray(image.convert("RGBA"))
        return pixels[:, :, 3] if pixels[:, :, 3].min() < 255 else pixels[:, :, :3].max(axis=2)
    return np.asarray(image.convert("RGB")).max(axis=2)
