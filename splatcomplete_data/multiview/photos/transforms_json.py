"""Read ``transforms.json`` as instant-ngp and nerfstudio write it.

Conventions
-----------
* ``transform_matrix`` is world-from-camera with OpenGL camera axes (x right, y up, z backward);
  the camera axes are turned into OpenCV's here, the world frame is left as it is.
* Intrinsics stand at the top level or in a frame, which wins. Without ``fl_x`` they come from
  ``camera_angle_x``. The size comes from the file (``w``, ``h``) or else from the photo.
* In a folder of photos that is named apart, a photo is found by as much of the end of its
  ``file_path`` as fits there: ``left/0001.png`` before ``0001.png``.
* Frames whose photo is missing are left out and counted, never silently: instant-ngp's own fox
  lists more frames than it ships. So are frames whose photo lies out of reach (``named_files``).
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gscomplete.errors import UserError
from gscomplete.util import jsonio
from gscomplete.util.arrays import Float64Array
from splatcomplete_data.multiview.photos.images import photo_size
from splatcomplete_data.multiview.photos.lens import Lens
from splatcomplete_data.multiview.photos.posed import PosedPhoto, PosedPhotos
from splatcomplete_data.named_files import Reach

_OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
_SUFFIXES = (".png", ".jpg", ".jpeg")
_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "OPENCV_FISHEYE", "PERSPECTIVE")


def read_transforms(
    path: Path, images: Path | None = None, allow_outside: Path | None = None
) -> PosedPhotos:
    """Read a capture.

    Args:
        path: the JSON file.
        images: folder of the photos; None = where ``file_path`` says, relative to the JSON file.
        allow_outside: folder below which photos and masks are read, too; None = only those below
            the JSON file's folder, or below ``images``.

    Raises:
        UserError: the file is not a transforms.json, a field is wrong, or fewer than three
            photos exist.
    """
    data = jsonio.read_json(path)
    if not isinstance(data, dict) or not isinstance(data.get("frames"), list):
        raise UserError(f"{path}: expected an object with an array 'frames', found none")
    photos: list[PosedPhoto] = []
    missing: list[str] = []
    refused: list[str] = []
    reach = Reach.of(path, allow_outside)
    among = reach if images is None else Reach.of(images / "any", allow_outside)
    for index, frame in enumerate(data["frames"]):
        where = f"{path}: frames[{index}]"
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise UserError(f"{where}: expected an object with a text 'file_path'")
        photo_path = _find_photo(path.parent, frame["file_path"], images)
        if photo_path is None:
            missing.append(frame["file_path"])
            continue
        refusal = among.refusal(photo_path)
        if refusal is not None:
            refused.append(f"{frame['file_path']} {refusal}")
            continue
        values = {**data, **frame}
        lens = _lens(values, photo_path, where)
        pose = _camera_from_world(frame.get("transform_matrix"), where)
        photos.append(PosedPhoto(photo_path, lens, pose, _mask(path.parent, frame, where, reach)))
    notes: tuple[str, ...] = ()
    if missing:
        notes = (
            f"{len(missing)} of {len(data['frames'])} frames left out: their photos do not exist "
            f"(first: {missing[0]})",
        )
    if refused:
        notes = (
            *notes,
            f"{len(refused)} of {len(data['frames'])} frames left out (first: photo {refused[0]})",
        )
    photos.sort(key=lambda photo: os.path.abspath(photo.path))
    return PosedPhotos(tuple(photos), None, str(path), notes)


def _find_photo(folder: Path, file_path: str, images: Path | None) -> Path | None:
    """Return the photo of a frame; synthetic data sets leave the suffix out."""
    if images is None:
        bases = [folder / file_path]
    else:
        parts = [
            part for part in Path(file_path).parts if part not in ("..", Path(file_path).anchor)
        ]
        bases = [images.joinpath(*parts[start:]) for start in range(len(parts))]
    for base in bases:
        for candidate in (base, *(base.with_name(base.name + suffix) for suffix in _SUFFIXES)):
            if candidate.is_file():
                return candidate
    return None


def _mask(folder: Path, frame: Mapping[str, Any], where: str, reach: Reach) -> Path | None:
    """Return the frame's own mask.

    Raises:
        UserError: the frame names a mask that does not exist, or may not be read.
    """
    name = frame.get("mask_path")
    if name is None:
        return None
    if not isinstance(name, str) or not (folder / name).is_file():
        raise UserError(f"{where}: mask_path: expected an image file, found {name!r}")
    refusal = reach.refusal(folder / name)
    if refusal is not None:
        raise UserError(f"{where}: mask_path: {name} {refusal}")
    return folder / name


def _number(values: Mapping[str, Any], name: str, default: float, where: str) -> float:
    """Return a finite number of a frame.

    Raises:
        UserError: it is something else.
    """
    value = values.get(name, default)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not abs(value) <= sys.float_info.max:
        raise UserError(f"{where}: {name}: expected a finite number, found {value!r}")
    return float(value)


def _lens(values: Mapping[str, Any], photo: Path, where: str) -> Lens:
    """Build the lens of a frame from its fields and those of the top level.

    Raises:
        UserError: a field is missing or wrong, or the photo cannot be read.
    """
    photo_width, photo_height = photo_size(photo)
    width = _number(values, "w", photo_width, where)
    height = _number(values, "h", photo_height, where)
    if (round(width), round(height)) != (photo_width, photo_height):
        raise UserError(
            f"{where}: w, h: expected the size of {photo.name}, {photo_width} x {photo_height}, "
            f"found {width:g} x {height:g}"
        )
    model = values.get("camera_model", "OPENCV")
    fisheye = model == "OPENCV_FISHEYE" or bool(values.get("is_fisheye", False))
    if model not in _MODELS:
        raise UserError(
            f"{where}: camera_model: expected one of {', '.join(_MODELS)}, found {model!r}"
        )
    if "fl_x" in values:
        focal_x = _number(values, "fl_x", 0.0, where)
    elif "camera_angle_x" in values:
        angle = _number(values, "camera_angle_x", 0.0, where)
        if not 0 < angle < math.pi:
            raise UserError(f"{where}: camera_angle_x: expected 0 to pi, found {angle:g}")
        focal_x = 0.5 * width / math.tan(angle / 2)
    else:
        raise UserError(f"{where}: expected a focal length 'fl_x' or 'camera_angle_x', found none")
    focal_y = _number(values, "fl_y", focal_x, where)
    center_x = _number(values, "cx", width / 2, where)
    center_y = _number(values, "cy", height / 2, where)
    k1, k2, k3, k4 = (_number(values, f"k{i}", 0.0, where) for i in range(1, 5))
    p1, p2 = (_number(values, f"p{i}", 0.0, where) for i in (1, 2))
    if k4 and not fisheye:
        raise UserError(f"{where}: k4: expected 0 for camera_model {model}, found {k4:g}")
    try:
        return Lens(
            photo_width,
            photo_height,
            (focal_x, focal_y),
            (center_x, center_y),
            "fisheye" if fisheye else "brown",
            (k1, k2, k3, k4, 0.0, 0.0),
            (0.0, 0.0) if fisheye else (p1, p2),
        )
    except ValueError as error:
        raise UserError(f"{where}: {error}") from error


def _camera_from_world(value: Any, where: str) -> Float64Array:  # [4, 4]
    """Turn a frame's matrix into OpenCV's camera-from-world.

    Raises:
        UserError: it is not a matrix of finite numbers that can be inverted.
    """
    try:
        matrix = np.asarray(value, np.float64)
    except (OverflowError, TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise UserError(f"{where}: transform_matrix: expected 4 x 4 finite numbers")
    if abs(np.linalg.det(matrix[:3, :3])) < 1e-9:
        raise UserError(f"{where}: transform_matrix: expected a rotation, found a singular matrix")
    if not np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0]):
        last = " ".join(f"{number:g}" for number in matrix[3])
        raise UserError(f"{where}: transform_matrix: expected a last row of 0 0 0 1, found {last}")
    inverse: Float64Array = np.linalg.inv(matrix @ _OPENCV_FROM_OPENGL).astype(np.float64)
    return inverse
