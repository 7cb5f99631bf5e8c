"""Photos to training views: undistorted, scaled down, and masked.

Conventions
-----------
* A view holds 8-bit sRGB colours [H, W, 3] and two masks [H, W] of 8 bits: ``weight``, how much a
  pixel counts (0 where the undistorted image shows nothing), and ``alpha``, whether it shows the
  object. Without masks ``alpha`` is None: everything is to be reconstructed.
* Masks: the photo's own alpha channel, a mask named by the capture, or ``masks/NAME.png`` (also
  ``masks/NAME.jpg.png``) beside the photos' folder, where NAME is the photo's in the capture
  (``PosedPhotos.names``), with its folders. White is the object, or what counts.
* Pixels are taken as stored: an EXIF orientation turns nothing, it only tells which way is up.
* Scaling averages areas, in 8-bit sRGB as everyone does; intrinsics are scaled with it.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from gscomplete.errors import UserError
from gscomplete.util.arrays import Float64Array
from gscomplete.views import Cameras
from splatcomplete_data.multiview.photos.lens import Lens, SourceMap, undistort
from splatcomplete_data.multiview.photos.posed import PosedPhoto, PosedPhotos
from splatcomplete_data.pictures import SHOWN_AXES, UPRIGHT, eight_bits, orientation, read_mask

MaskMeaning = Literal["object", "ignore"]
"""``object``: outside the mask nothing is to be reconstructed. ``ignore``: pixels outside the mask
do not count, whatever the splats show there."""
PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp")
_UNREAD_SUFFIXES = (
    *(".heic", ".heif", ".avif", ".jxl", ".jp2", ".gif"),
    *(".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw"),
)
"""Photos too, but of kinds that are not read."""


@dataclass(frozen=True, slots=True)
class View:
    """One photo as training sees it."""

    name: str  # as in ``PosedPhotos.names``
    camera: Cameras  # one pinhole camera, float32
    colors: NDArray[np.uint8]  # [H, W, 3] sRGB
    weight: NDArray[np.uint8]  # [H, W], 255 counts fully
    alpha: NDArray[np.uint8] | None  # [H, W], 255 shows the object; None = no mask


def list_photos(folder: Path) -> list[Path]:
    """Return the photos of a folder, sorted by name.

    Raises:
        UserError: the folder is missing or holds no photo.
    """
    if not folder.is_dir():
        raise UserError(f"{folder}: expected a folder of photos, found none")
    photos = sorted(path for path in folder.iterdir() if path.suffix.lower() in PHOTO_SUFFIXES)
    if not photos:
        raise UserError(
            f"{folder}: expected photos ({', '.join(PHOTO_SUFFIXES)}), found "
            f"{left_out_note(folder) or 'none in this folder'}"
        )
    return photos


def left_out_note(folder: Path) -> str | None:
    """Return a note on a folder's photos of kinds that are not read; None without any.

    One that lies beside a photo of its name (a camera's raw file, a converted one) is not missed.
    """
    if not folder.is_dir():
        return None
    files = [path for path in folder.iterdir() if path.is_file()]
    read = {path.stem for path in files if path.suffix.lower() in PHOTO_SUFFIXES}
    left = [path for path in files if path.suffix.lower() in _UNREAD_SUFFIXES]
    counts = Counter(path.suffix.lower() for path in left if path.stem not in read)
    if not counts:
        return None
    kinds = ", ".join(f"{count} {suffix}" for suffix, count in sorted(counts.items()))
    return f"photos of formats that are not read ({kinds}): convert them to JPEG or PNG"


def read_photo(path: Path) -> NDArray[np.uint8]:  # [H, W, 3 or 4]
    """Read a photo as 8-bit RGB or RGBA, as its pixels are stored.

    An orientation tag turns nothing, as in COLMAP: poses belong to the stored pixels.

    Raises:
        UserError: the file is not a picture, or is damaged.
    """
    with _opened(path) as image:
        narrow = eight_bits(image)
        has_alpha = "A" in narrow.getbands() or "transparency" in narrow.info
        return np.asarray(narrow.convert("RGBA" if has_alpha else "RGB"))


def photo_size(path: Path) -> tuple[int, int]:
    """Return a photo's width and height as its pixels are stored.

    Raises:
        UserError: the file is not a picture.
    """
    with _opened(path) as image:
        return image.size


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """Open a picture; what goes wrong with it in the block is the user's error.

    Raises:
        UserError: the file is not a picture, or is damaged.
    """
    try:
        with Image.open(path) as image:
            yield image
    except (OSError, UnidentifiedImageError, ValueError, SyntaxError) as error:
        raise UserError(f"{path}: cannot read it as a picture ({error})") from error
    except Image.DecompressionBombError as error:
        raise UserError(f"{path}: more pixels than a photo has ({error})") from error


def shown_axes(path: Path) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return where a photo's viewer sees right and up, as steps (x, y) in the stored pixels.

    A photo that cannot be read counts as upright: loading its pixels is what reports it.
    """
    tag = UPRIGHT
    with contextlib.suppress(UserError), _opened(path) as image:
        tag = orientation(image)
    return SHOWN_AXES[tag]


def orientation_note(photos: Sequence[Path]) -> str | None:
    """Return a note on photos that carry an orientation tag; None without any."""
    turned = [path.name for path in photos if shown_axes(path) != SHOWN_AXES[UPRIGHT]]
    if not turned:
        return None
    return (
        f"{len(turned)} of {len(photos)} photos carry an EXIF rotation (first: {turned[0]}): it "
        "tells which way is up, but pixels are used as stored; poses and masks must be those of "
        "the stored pixels"
    )


def find_mask(photo: PosedPhoto, name: str, masks: Path | None) -> Path | None:
    """Return the mask file of a photo of that name: its own, or the one in the folder of masks.

    Raises:
        UserError: there is a folder of masks, and this photo has none in it.
    """
    if photo.mask_path is not None or masks is None:
        return photo.mask_path
    stem = str(PurePosixPath(name).with_suffix(""))
    for candidate in (f"{name}.png", *(f"{stem}{suffix}" for suffix in PHOTO_SUFFIXES)):
        if (masks / candidate).is_file():
            return masks / candidate
    raise UserError(
        f"{masks}: expected a mask for every photo, found none for {name} (such as {stem}.png)"
    )


def load_views(
    capture: PosedPhotos,
    *,
    max_side_px: int,
    masks: Path | None = None,
    mask_means: MaskMeaning = "object",
) -> list[View]:
    """Load every photo of a capture.

    Args:
        capture: photos with cameras.
        max_side_px: photos are scaled down until neither side is longer.
        masks: folder of masks; None = alpha channels and masks that the capture names, if any.
        mask_means: what a mask says.

    Raises:
        UserError: a photo or mask cannot be read or has the wrong size, or only some photos have
            a mask.
    """
    views = []
    source: SourceMap | None = None
    for photo, name in zip(capture.photos, capture.names, strict=True):
        if source is None or source.lens != photo.lens:  # photos of one camera share its lens
            source = SourceMap.of(photo.lens)
        views.append(_load(photo, source, name, max_side_px, masks, mask_means))
    masked = sum(view.alpha is not None for view in views)
    if 0 < masked < len(views):
        without = next(view.name for view in views if view.alpha is None)
        raise UserError(
            f"{capture.source}: expected a mask for every photo or for none, found {masked} masks "
            f"for {len(views)} photos ({without} has none)"
        )
    return views


def _load(
    photo: PosedPhoto,
    source: SourceMap,
    name: str,
    max_side_px: int,
    masks: Path | None,
    mask_means: MaskMeaning,
) -> View:
    """Load, undistort and scale one photo."""
    pixels = read_photo(photo.path)
    height, width = pixels.shape[:2]
    if (width, height) != (photo.lens.width, photo.lens.height):
        raise UserError(
            f"{photo.path}: expected {photo.lens.width} x {photo.lens.height} pixels as its camera "
            f"has, found {width} x {height}"
        )
    mask_path = find_mask(photo, name, masks)
    shown: NDArray[np.uint8] | None = pixels[:, :, 3] if pixels.shape[2] == 4 else None
    if mask_path is not None:
        shown = _read_mask(mask_path, width, height)
    layers = pixels[:, :, :3] if shown is None else np.dstack([pixels[:, :, :3], shown])
    image, inside = undistort(np.ascontiguousarray(layers), source)
    small_width, small_height = scaled_size(width, height, max_side_px)
    scale = Image.fromarray(image).resize, Image.fromarray(inside.astype(np.uint8) * 255).resize
    image, weight = (
        np.array(resize((small_width, small_height), Image.Resampling.BOX)) for resize in scale
    )
    # A pixel that mixes photo with the black beyond its edge has a wrong colour: it does not count.
    weight = np.where(weight == 255, np.uint8(255), np.uint8(0))
    alpha = image[:, :, 3] if shown is not None else None
    if alpha is not None and mask_means == "ignore":
        weight, alpha = np.minimum(weight, alpha), None
    camera = pinhole_camera(photo.lens, photo.camera_from_world)
    return View(
        name,
        camera.resized(small_width, small_height),
        np.ascontiguousarray(image[:, :, :3]),
        weight,
        alpha,
    )


def _read_mask(path: Path, width: int, height: int) -> NDArray[np.uint8]:  # [H, W]
    """Read a photo's mask.

    Raises:
        UserError: it cannot be read, or has another size than its photo.
    """
    mask = read_mask(path)
    if mask.shape != (height, width):
        raise UserError(
            f"{path}: expected a mask of its photo's size, {width} x {height}, found "
            f"{mask.shape[1]} x {mask.shape[0]}"
        )
    return mask


def scaled_size(width: int, height: int, max_side_px: int) -> tuple[int, int]:
    """Return the size at which neither side is longer than ``max_side_px`` (never larger)."""
    factor = min(1.0, max_side_px / max(width, height))
    return max(1, round(width * factor)), max(1, round(height * factor))


def pinhole_camera(lens: Lens, camera_from_world: Float64Array) -> Cameras:
    """Return the pinhole camera of an undistorted photo, in float64."""
    return Cameras(
        torch.from_numpy(camera_from_world)[None],
        torch.tensor([lens.focal_px], dtype=torch.float64),
        torch.tensor([lens.center_px], dtype=torch.float64),
        lens.width,
        lens.height,
    )
