"""A trained scene to crop from: a splat file, and its capture's cameras where they are known.

Conventions
-----------
* A capture folder (``reconstruct``) gives cameras, what they look at, and the up direction; a
  plain PLY gives none of them, and its up axis is -Y, as in most trained files. Who knows better
  says so, of either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.folders.drawable import drawable_of
from gscomplete.splats import Splats, read_splats, usable_rows
from gscomplete.splats.formats.any_file import read_splat_file
from gscomplete.splats.ply import SplatFile
from gscomplete.splats.transform import Similarity
from gscomplete.util import jsonio
from gscomplete.util.arrays import Float64Array
from gscomplete.util.file_names import OBJECT_FILE, RUN_FILE
from gscomplete.views import Cameras, UpAxis, orbit_cameras, radius_to_fit, up_rotation
from splatcomplete_data.cuts.boxes import CropBox
from splatcomplete_data.framing import SPLAT_FILE_UP, UP_ASSUMED
from splatcomplete_data.multiview.capture_folder import CAPTURE_FILE, SPLATS_FILE
from splatcomplete_data.multiview.propose_box import Focus, focus_of_cameras, focus_of_splats
from splatcomplete_data.multiview.reconstruct import SCHEMA
from splatcomplete_data.multiview.training.settings import TrainingSettings

PICTURES = 4
_PICTURE_PX = 360
_LARGEST_PX = 100_000
"""Of a picture's side."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What is to be cropped."""

    name: Path  # as the user named it
    file: SplatFile
    capture: dict[str, Any] | None  # content of capture.json
    cameras: tuple[Cameras, ...]
    up_axis: UpAxis
    up: Float64Array  # [3], in the file's frame
    near: float
    notes: tuple[str, ...]

    def drawable(self) -> Splats:
        """Return the splats that can be drawn."""
        return self.file.splats.select(usable_rows(self.file.splats)[0])

    def positions(self) -> Float64Array:  # [V, 3]
        """Return the camera centres."""
        return np.stack([camera.positions[0].numpy() for camera in self.cameras])

    def focus(self) -> Focus:
        """Return where to look for the object."""
        if self.capture is None:
            return focus_of_splats(self.file.splats, self.up)
        look_at = np.array(self.capture["look_at"], np.float64)
        return focus_of_cameras(self.cameras, look_at, self.up)

    def picture_cameras(
        self, boxes: Sequence[CropBox], shown: Splats | None = None
    ) -> list[Cameras]:
        """Return cameras to draw from: some of the capture's, or an orbit.

        Args:
            boxes: the orbit is about the first that keeps.
            shown: without boxes, what the orbit is about; None = all splats.
        """
        if self.cameras:
            step = max(1, len(self.cameras) // PICTURES)
            chosen = self.cameras[step // 2 :: step][:PICTURES]
            return [_fitted(camera) for camera in chosen]
        center, size = self._middle(boxes, shown)
        rotation = up_rotation(self.up_axis)
        orbit = orbit_cameras(
            torch.tensor([0.0, 90.0, 180.0, 270.0]),
            torch.full((4,), 20.0),
            radius=radius_to_fit(2.0 * size, 45.0),
            fov_deg=45.0,
            size_px=_PICTURE_PX,
        )
        # The orbit is about the origin of z-up axes; the file's axes are turned and shifted.
        level = Similarity(1.0, rotation, -(rotation @ torch.from_numpy(center)))
        matrix = torch.eye(4, dtype=torch.float64)
        matrix[:3, :3], matrix[:3, 3] = level.rotation, level.translation
        poses = orbit.camera_from_world.double() @ matrix
        turned = Cameras(poses, orbit.focal_px, orbit.center_px, orbit.width, orbit.height)
        return [turned[index] for index in range(len(turned))]

    def front_position(self, boxes: Sequence[CropBox]) -> tuple[float, float, float] | None:
        """Return the centre of the camera in the middle of all, as seen from the boxes.

        People photograph the side that matters from more places than its back.
        """
        if not self.cameras:
            return None
        positions = self.positions()
        away = positions - self._middle(boxes)[0]
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        x, y, z = positions[int((away @ away.mean(axis=0)).argmax())].tolist()
        return x, y, z

    def details(self) -> dict[str, Any]:
        """Return what the object's record should know about the capture."""
        if self.capture is None:
            return {}
        kept = ("source", "world_from_source", "result", "identity")
        return {"capture": {name: self.capture.get(name) for name in kept}}

    def _middle(
        self, boxes: Sequence[CropBox], shown: Splats | None = None
    ) -> tuple[Float64Array, float]:
        """Return centre and size of what is kept: the first box, or the splats that are shown."""
        for box in boxes:
            if box.action == "keep":
                return np.array(box.center), 2.0 * max(box.half_extents)
        points = (shown or self.drawable()).means.double().numpy()
        low, high = np.quantile(points, [0.02, 0.98], axis=0)
        return (low + high) / 2, max(float((high - low).max()), 1e-9)


def _fitted(camera: Cameras) -> Cameras:
    """Return a camera whose picture is about as high as the others of a sheet."""
    factor = _PICTURE_PX / max(camera.width, camera.height)
    return camera.resized(
        max(1, round(camera.width * factor)), max(1, round(camera.height * factor))
    )


def read_scene(path: Path, up_axis: UpAxis | None = None) -> Scene:
    """Read a splat file, or what a capture, run or object folder holds.

    Args:
        path: the file or folder.
        up_axis: the file axis that points up; None = as the capture's cameras or the folder say,
            else -Y.

    Raises:
        UserError: it is neither, or the capture is not finished.
    """
    if not (path.is_dir() and (path / CAPTURE_FILE).is_file()):
        folders = (CAPTURE_FILE, RUN_FILE, OBJECT_FILE)
        if path.is_dir() and not any((path / name).is_file() for name in folders):
            expected = ", ".join(folders)
            raise UserError(f"{path}: expected a splat file, or a folder with one of {expected}")
        drawable = drawable_of(path)
        file = read_splat_file(drawable.file)
        low, high = (corner.double() for corner in _bounds(file))
        near = 1e-3 * max(float((high - low).max()), 1e-9)
        known = up_axis or (None if drawable.frame is None else drawable.frame.up)
        notes = () if known else (UP_ASSUMED,)
        axis = known or SPLAT_FILE_UP
        return Scene(path, file, None, (), axis, _direction(axis), near, notes)
    capture = jsonio.read_json(path / CAPTURE_FILE)
    if not isinstance(capture, dict) or capture.get("schema") != SCHEMA:
        raise UserError(f"{path / CAPTURE_FILE}: schema: expected {SCHEMA!r}")
    if capture.get("status") != "finished":
        raise UserError(f"{path}: the capture is not finished; continue it with images --resume")
    try:
        cameras = tuple(_camera(entry) for entry in capture["cameras"])
        up = np.array(capture["up"], np.float64).reshape(3)
        if not 0 < np.linalg.norm(up) < np.inf:
            raise ValueError(f"up: expected a direction, found {capture['up']}")
        near = TrainingSettings().near_extent * float(capture["extent"])
        if not 0 < near < np.inf:
            raise ValueError(f"extent: expected a positive length, found {capture['extent']}")
        look_at = np.array(capture["look_at"], np.float64).reshape(3)
        if not np.isfinite(look_at).all():
            raise ValueError(f"look_at: expected finite numbers, found {capture['look_at']}")
    except (KeyError, OverflowError, RuntimeError, TypeError, ValueError) as error:
        raise UserError(f"{path / CAPTURE_FILE}: cannot understand it ({error!r})") from error
    axis = up_axis or nearest_axis(up)
    angle = _angle_deg(up, _direction(axis))
    note = f"up axis {axis}, {angle:.0f} degrees from the cameras' mean up direction"
    if up_axis:
        up = _direction(up_axis)
    file = read_splats(path / SPLATS_FILE)
    return Scene(path, file, capture, cameras, axis, up, near, (note,))


def nearest_axis(up: Float64Array) -> UpAxis:  # [3]
    """Return the file axis nearest to a direction."""
    axes: tuple[UpAxis, ...] = ("X", "Y", "Z", "-X", "-Y", "-Z")
    return axes[int(np.concatenate([up, -up]).argmax())]


def _direction(axis: UpAxis) -> Float64Array:  # [3]
    """Return a file axis as a direction."""
    return np.asarray(up_rotation(axis).numpy()[2])


def _angle_deg(a: Float64Array, b: Float64Array) -> float:  # [3], [3]
    """Return the angle between two directions in degrees."""
    along = float(a @ b) / float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.degrees(np.arccos(min(max(along, -1.0), 1.0))))


def _bounds(file: SplatFile) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the box of the splats that can be drawn.

    Raises:
        UserError: there is none.
    """
    usable, _ = usable_rows(file.splats)
    if not bool(usable.any()):
        raise UserError(f"{file.path}: expected splats that can be drawn, found none")
    return file.splats.select(usable).bounds()


def _camera(entry: dict[str, Any]) -> Cameras:
    """Read one camera of a capture.

    Raises:
        ValueError: a number is not finite, a focal length not positive, or a picture of no size.
    """
    matrices, focal_px, center_px = (
        torch.tensor([entry[name]], dtype=torch.float64)
        for name in ("camera_from_world", "focal_px", "center_px")
    )
    width, height = int(entry["width"]), int(entry["height"])
    if not all(bool(values.isfinite().all()) for values in (matrices, focal_px, center_px)):
        raise ValueError("cameras: expected finite numbers")
    if focal_px.min() <= 0 or not 0 < width <= _LARGEST_PX or not 0 < height <= _LARGEST_PX:
        raise ValueError("cameras: expected positive focal_px, width and height")
    return Cameras(matrices, focal_px, center_px, width, height)
