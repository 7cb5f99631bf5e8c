"""Read depth images: NPY, NPZ, 16-bit PNG, PGM, TIFF, EXR, and Depth Anything 3's results.npz.

Conventions
-----------
* ``DepthImage.values`` holds the file's numbers, float64 [H, W], with unknown pixels as NaN.
  Unknown are zeros, negative values, NaN and infinities, and also numbers that stand for infinity:
  1e9 and more in floats (Blender writes 1e10), and the largest value of 16-bit integers. A note
  counts the latter.
* ``metric_depth`` turns values into distances along the optical axis (camera-space z):
  ``metric`` value x unit; ``disparity`` focal x baseline / (value x unit + offset);
  ``inverse`` unit / value. Nothing is guessed but the unit of integer images, which is said:
  16-bit integers are millimetres unless ``unit`` is given.
* Depth Anything 3 works at its own resolution, and gives intrinsics for that or none at all; its
  picture, intrinsics and confidence come along when they are there.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gscomplete.errors import UserError
from gscomplete.util.arrays import Float64Array
from gscomplete.util.limits import check_decoded_bytes
from gscomplete.util.optional import import_optional

DepthKind = Literal["metric", "disparity", "inverse"]
"""What the numbers are; see the module's conventions."""
MILLIMETRE = 0.001
_ENDLESS = 1e9
"""Floats from here on stand for infinity."""
_LARGEST_16_BIT = 65535
MAX_PIXELS = 2**26
"""Depth images with more, 8192 x 8192, are refused."""
_MAX_CHANNELS = 64
_READ_FROM_NPZ = ("depth", "disparity", "disp", "arr_0", "image", "intrinsics", "conf")


@dataclass(frozen=True, slots=True, eq=False)
class DepthImage:
    """A depth file as read."""

    values: Float64Array  # [H, W], unknown = NaN
    is_integer: bool
    color: NDArray[np.uint8] | None = None  # [H, W, 3], None = the file has none
    intrinsics: Float64Array | None = None  # [3, 3], None = the file has none
    confidence: Float64Array | None = None  # [H, W], None = the file has none
    notes: tuple[str, ...] = ()


def read_depth(path: Path, frame: int = 0) -> DepthImage:
    """Read a depth file.

    Args:
        path: the file.
        frame: which picture of an NPZ or NPY that holds several.

    Raises:
        UserError: it is missing, of no known kind, damaged, or has no valid pixel.
    """
    if not path.is_file():
        raise UserError(f"{path}: expected a depth file, found none")
    suffix = path.suffix.lower()
    try:
        if suffix == ".npz":
            image = _read_npz(path, frame)
        elif suffix == ".npy":
            values = np.load(path, mmap_mode="r", allow_pickle=False)
            image = _plain(np.asarray(values), frame, path)
        elif suffix in (".exr", ".tif", ".tiff"):
            image = _plain(_read_oiio(path), 0, path)
        elif suffix in (".png", ".pgm"):
            image = _plain(_read_picture(path), 0, path)
        else:
            known = ".npy, .npz, .png, .pgm, .tif, .exr"
            raise UserError(f"{path}: depth: expected {known}, found suffix {suffix!r}")
    except UserError:
        raise
    except Exception as error:  # damaged files raise whatever their reader happens to raise
        raise UserError(f"{path}: cannot read it as depth ({error})") from error
    if not np.isfinite(image.values).any():
        raise UserError(f"{path}: depth: expected positive finite values, found none")
    return image


def metric_depth(
    image: DepthImage,
    kind: DepthKind,
    *,
    unit: float | None = None,
    focal_px: float = 1.0,
    baseline: float | None = None,
    offset: float = 0.0,
) -> tuple[Float64Array, str]:  # [H, W], NaN = unknown
    """Turn a file's values into camera-space z.

    Args:
        image: as read.
        kind: what the values are.
        unit: length of one unit of ``metric``, the z of value 1 of ``inverse``, or the pixels of
            one unit of ``disparity`` (KITTI's: 1/256); None = 1, or 0.001 for integers that are
            no disparities.
        focal_px: focal length in pixels of the depth image, for disparity.
        baseline: distance of the two cameras, for disparity.
        offset: what is added to disparities (the difference of the principal points).

    Returns:
        Depths, and a sentence on what was assumed.

    Raises:
        UserError: a number that the kind needs is missing or wrong.
    """
    values = image.values
    if unit is not None and not 0 < unit < float("inf"):
        raise UserError(f"--unit: expected a positive number, found {unit:g}")
    if kind == "disparity":
        values = values * (1.0 if unit is None else unit)
        if baseline is None or baseline <= 0:
            raise UserError("--baseline: expected a positive distance for disparities, found none")
        shifted = np.where(values + offset > 0, values + offset, np.nan)
        return focal_px * baseline / shifted, f"z = {focal_px:g} x {baseline:g} / (d + {offset:g})"
    scale = (MILLIMETRE if image.is_integer else 1.0) if unit is None else unit
    assumed = " (assumed: integers are millimetres)" if unit is None and image.is_integer else ""
    if kind == "inverse":
        return scale / values, f"z = {scale:g} / value"
    return values * scale, f"z = value x {scale:g}{assumed}"


def _plain(values: NDArray[np.generic], frame: int, path: Path) -> DepthImage:
    """Turn an array into a depth image.

    Raises:
        UserError: it holds no real numbers, those of 8 bits, or has another shape.
    """
    is_real = np.issubdtype(values.dtype, np.number) and not np.iscomplexobj(values)
    if not is_real:
        raise UserError(f"{path}: depth: expected real numbers, found {values.dtype}")
    if values.dtype.itemsize == 1:
        raise UserError(_too_few_bits(path))
    while values.ndim > 2 and values.shape[-1] == 1:
        values = values[..., 0]
    if values.ndim == 3 and values.shape[-1] in (3, 4) and len(values) > 8:
        raise UserError(
            f"{path}: depth: expected one channel, found {values.shape[-1]} (a picture)"
        )
    if values.ndim == 3:
        if not 0 <= frame < len(values):
            raise UserError(f"{path}: --frame: expected 0 to {len(values) - 1}, found {frame}")
        values = values[frame]
    if values.ndim != 2 or 0 in values.shape:
        raise UserError(f"{path}: depth: expected height x width, found shape {values.shape}")
    _check_pixels(path, values.shape[1], values.shape[0])
    is_integer = bool(np.issubdtype(values.dtype, np.integer))
    numbers = values.astype(np.float64)
    endless = np.isfinite(numbers) & (numbers >= (_LARGEST_16_BIT if is_integer else _ENDLESS))
    if is_integer and numbers.max() > _LARGEST_16_BIT:
        endless[:] = False  # wider integers: it stands for itself
    numbers[endless | ~(np.isfinite(numbers) & (numbers > 0))] = np.nan
    found = f"{int(endless.sum()):,} pixels hold a value for infinity; their depth is unknown"
    return DepthImage(numbers, is_integer, notes=(found,) if endless.any() else ())


def _read_npz(path: Path, frame: int) -> DepthImage:
    """Read an NPZ: Depth Anything 3's results, or any with one array or one called depth."""
    with np.load(path, allow_pickle=False) as data:
        names = list(data.files)
        for member in data.zip.infolist():
            if member.filename.removesuffix(".npy") in _READ_FROM_NPZ or len(names) == 1:
                check_decoded_bytes(path, member.file_size, member.filename)
        key = next((n for n in ("depth", "disparity", "disp", "arr_0") if n in names), None)
        if key is None and len(names) == 1:
            key = names[0]
        if key is None:
            raise UserError(f"{path}: expected an array 'depth', found {', '.join(names)}")
        plain = _plain(data[key], frame, path)
        shape = plain.values.shape

        def extra(name: str, tail: tuple[int, ...]) -> NDArray[np.generic] | None:
            if name not in names:
                return None
            array = data[name]
            array = array[frame] if array.ndim == len(tail) + 1 else array
            if array.shape != tail:
                raise UserError(f"{path}: {name}: expected shape {tail}, found {array.shape}")
            return array

        color = extra("image", (*shape, 3))
        matrix = extra("intrinsics", (3, 3))
        confidence = extra("conf", shape)
    notes = plain.notes
    if matrix is None:
        notes = (*notes, "the depth file has no intrinsics")
    return DepthImage(
        plain.values,
        plain.is_integer,
        None if color is None else _bytes(color),
        None if matrix is None else matrix.astype(np.float64),
        None if confidence is None else confidence.astype(np.float64),
        notes,
    )


def _check_pixels(path: Path, width: int, height: int) -> None:
    """Refuse a picture that would fill the memory.

    Raises:
        UserError: it has too many pixels.
    """
    if width * height > MAX_PIXELS:
        raise UserError(
            f"{path}: depth: expected at most {MAX_PIXELS:,} pixels, found {width} x {height}"
        )


def _bytes(color: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Return a picture's bytes; floats up to 1 are shares of 255."""
    if np.issubdtype(color.dtype, np.floating):
        numbers = np.nan_to_num(color.astype(np.float64))
        color = np.round(numbers * (255.0 if numbers.max(initial=0.0) <= 1.0 else 1.0))
    return color.clip(0, 255).astype(np.uint8)


def _read_picture(path: Path) -> NDArray[np.generic]:
    """Read a PNG or PGM of 16 or 32 bits."""
    with Image.open(path) as image:
        _check_pixels(path, *image.size)
        if image.mode in ("1", "L"):
            raise UserError(_too_few_bits(path))
        if image.mode != "F" and not image.mode.startswith("I"):
            raise UserError(f"{path}: depth: expected one channel, found a {image.mode} picture")
        values = np.asarray(image)
    if np.issubdtype(values.dtype, np.integer):  # Pillow's mode I holds 16-bit PNGs
        values = values.astype(np.int64)
        largest = _pgm_largest(path)
        if largest is not None:  # Pillow has scaled the numbers to 16 bits
            values = np.round(values * (largest / _LARGEST_16_BIT)).astype(np.int64)
    return values


def _too_few_bits(path: Path) -> str:
    return f"{path}: depth: expected 16 bits a pixel, found 8 (a preview?)"


def _pgm_largest(path: Path) -> int | None:
    """Return the largest value that a PGM's header says its numbers have; None for other files."""
    with path.open("rb") as stream:
        head = stream.read(1024)
    if head[:2] not in (b"P2", b"P5"):
        return None
    words = re.sub(rb"#[^\n]*", b"", head).split(maxsplit=4)
    return int(words[3])


def _read_oiio(path: Path) -> NDArray[np.generic]:
    """Read EXR or TIFF by way of OpenImageIO; of several channels the one called Z or depth."""
    oiio = import_optional("OpenImageIO", "reading EXR and TIFF files")
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise UserError(f"{path}: cannot read it ({oiio.geterror()})")
    spec = source.spec()
    _check_pixels(path, spec.width, spec.height)
    if spec.nchannels * spec.depth > _MAX_CHANNELS:
        raise UserError(
            f"{path}: depth: expected at most {_MAX_CHANNELS} channels, found "
            f"{spec.nchannels} x {spec.depth}"
        )
    names = [name.lower() for name in spec.channelnames]
    is_float = str(spec.format) in ("float", "half", "double")
    if str(spec.format) in ("uint8", "int8"):
        raise UserError(_too_few_bits(path))
    values = np.asarray(source.read_image("float" if is_float else str(spec.format)))
    source.close()
    if values.ndim < 2:
        raise UserError(f"{path}: cannot read it ({source.geterror()})")
    if values.ndim == 3 and values.shape[-1] > 1:
        known = [i for i, name in enumerate(names) if name in ("z", "depth", "y")]
        same = bool(np.array_equal(values[..., 0], values[..., 1], equal_nan=True))
        if not known and not same:
            raise UserError(f"{path}: depth: expected a channel Z or one, found {', '.join(names)}")
        values = values[..., known[0] if known else 0]
    return values
