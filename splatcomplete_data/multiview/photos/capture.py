"""Open what a user has: a folder of photos, a COLMAP model, or a ``transforms.json``.

Conventions
-----------
* ``--poses auto`` takes the first of: a ``transforms.json`` or a COLMAP model (``sparse/0``) in
  the folder; else structure from motion. Photos stand in the folder itself or in its ``images``;
  with given poses also in folders below these, as the poses name them.
* Given poses keep their world frame. COLMAP's own frame has no meaning, so after structure from
  motion the capture is levelled: z up, the origin where the cameras look, their mean distance
  from it 1, the first photo (by name) taken from azimuth 0. So two runs have one frame up to
  rounding, and boxes can be written down. The similarity is recorded with the result.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.splats import Similarity
from gscomplete.splats.rotations import turn_about_z, turn_onto_z
from gscomplete.util.arrays import Float64Array
from splatcomplete_data.multiview.photos.colmap_model import find_model, image_names, read_colmap
from splatcomplete_data.multiview.photos.images import PHOTO_SUFFIXES, left_out_note, shown_axes
from splatcomplete_data.multiview.photos.posed import PosedPhotos
from splatcomplete_data.multiview.photos.transforms_json import read_transforms
from splatcomplete_data.multiview.sfm.structure_from_motion import Progress, SfmSettings, find_poses

TRANSFORMS_FILE = "transforms.json"
_CLEAR_PLANE = 0.2
"""Horizontal camera axes name the up direction when they fill a plane: their smallest singular
value is below this share of the middle one."""


@dataclasses.dataclass(frozen=True, slots=True)
class Capture:
    """Posed photos, and how their world frame came from the source's."""

    posed: PosedPhotos
    world_from_source: Similarity | None  # None = the source's own frame


def open_capture(
    folder: Path,
    poses: str,
    work: Path,
    sfm: SfmSettings | None = None,
    progress: Progress | None = None,
    *,
    anew: bool = True,
    allow_outside: Path | None = None,
) -> Capture:
    """Open a capture.

    Args:
        folder: folder of photos, or one that holds photos and poses.
        poses: ``auto``, ``sfm``, or the path of a transforms.json or of a COLMAP model.
        work: folder that structure from motion may use.
        sfm: knobs of structure from motion; None = defaults.
        progress: told about its stages.
        anew: as in ``find_poses``.
        allow_outside: folder below which files that a transforms.json or a COLMAP model names are
            read, too; None = only those below the folder.

    Raises:
        UserError: there are no photos, no such poses, or they do not fit together.
    """
    if not folder.is_dir():
        raise UserError(f"{folder}: expected a folder of photos, found none")
    if poses == "auto":
        if (folder / TRANSFORMS_FILE).is_file():
            return Capture(read_transforms(folder / TRANSFORMS_FILE, None, allow_outside), None)
        model = find_model(folder)
        if model is not None:
            return Capture(read_colmap(model, _folder_of(model, folder), allow_outside), None)
    elif poses != "sfm":
        return Capture(_read_given(folder, Path(poses), allow_outside), None)
    return levelled(find_poses(photo_folder(folder), work, sfm, progress, anew=anew))


def _read_given(folder: Path, poses: Path, allow_outside: Path | None) -> PosedPhotos:
    """Read the poses that the user names.

    Raises:
        UserError: they are neither a transforms.json nor a COLMAP model.
    """
    if poses.is_file() and poses.suffix.lower() == ".json":
        beside = poses.parent == folder
        photos = None if beside else photo_folder(folder, below=True)
        return read_transforms(poses, photos, allow_outside)
    model = find_model(poses) if poses.is_dir() else None
    if model is None:
        raise UserError(
            f"--poses: expected auto, sfm, a transforms.json or a folder with a COLMAP model, "
            f"found {str(poses)!r}"
        )
    return read_colmap(model, _folder_of(model, folder), allow_outside)


def _folder_of(model: Path, folder: Path) -> Path:
    """Return the folder that the names in a COLMAP model start from: this one, or its ``images``.

    Raises:
        UserError: neither holds a photo.
    """
    names = image_names(model)
    found = {
        candidate: sum((candidate / name).is_file() for name in names)
        for candidate in (folder, folder / "images")
    }
    best = max(found, key=lambda candidate: found[candidate])
    return best if found[best] else photo_folder(folder, below=True)


def photo_folder(folder: Path, *, below: bool = False) -> Path:
    """Return the folder that holds the photos: this one, or ``images`` in it.

    Args:
        folder: where to look.
        below: where neither holds a photo itself, take one that has photos in folders below.

    Raises:
        UserError: there is no photo.
    """
    inner = folder / "images"
    places = [(folder, "*"), (inner, "*"), *([(inner, "**/*"), (folder, "**/*")] if below else [])]
    for place, pattern in places:
        if any(path.suffix.lower() in PHOTO_SUFFIXES for path in place.glob(pattern)):
            return place
    found = left_out_note(folder) or left_out_note(inner) or "none"
    raise UserError(
        f"{folder}: expected photos ({', '.join(PHOTO_SUFFIXES)}) in it or in its folder 'images', "
        f"found {found}"
    )


def find_masks(folder: Path) -> Path | None:
    """Return the folder of masks of a capture: ``masks`` in it or beside it, None without."""
    for candidate in (folder / "masks", folder.parent / "masks"):
        if candidate.is_dir():
            return candidate
    return None


def up_direction(posed: PosedPhotos) -> Float64Array:  # [3]
    """Return the world direction that is up in most photos.

    People hold cameras level, so the photos' x axes, as they are shown, are horizontal; where
    they point to many sides, up is what is perpendicular to all of them. Else it is the photos'
    mean up direction.
    """
    rotations = np.stack([photo.camera_from_world[:3, :3] for photo in posed.photos])
    shown = np.array([shown_axes(photo.path) for photo in posed.photos], np.float64)
    rights, ups = np.moveaxis(np.einsum("vai,vij->vaj", shown, rotations[:, :2]), 1, 0)
    mean = ups.mean(axis=0)
    if np.linalg.norm(mean) < 1e-6:
        return np.array([0.0, 0.0, 1.0])
    _, size, axes = np.linalg.svd(rights)
    up = axes[2] * np.sign(axes[2] @ mean)
    clear = size[2] < _CLEAR_PLANE * size[1] and up @ mean > 0.5 * np.linalg.norm(mean)
    return np.asarray(up if clear else mean / np.linalg.norm(mean))


def levelled(posed: PosedPhotos) -> Capture:
    """Turn, centre and scale a capture whose frame has no meaning (module conventions)."""
    up = up_direction(posed)
    middle = posed.look_at()
    distance = float(np.linalg.norm(posed.positions - middle, axis=1).mean())
    scale = 1.0 / distance if distance > 0 else 1.0
    rotation = turn_onto_z(up)
    first = rotation @ (posed.positions[0] - middle)
    rotation = turn_about_z(-float(np.arctan2(first[1], first[0]))) @ rotation
    world = Similarity(
        scale, torch.from_numpy(rotation), torch.from_numpy(-scale * rotation @ middle)
    )
    return Capture(transformed(posed, world), world)


def transformed(posed: PosedPhotos, world: Similarity) -> PosedPhotos:
    """Move cameras and points to another world frame; camera space is scaled along."""
    rotation, shift = world.rotation.numpy(), world.translation.numpy()
    photos = []
    for photo in posed.photos:
        old = photo.camera_from_world
        pose = np.eye(4)
        pose[:3, :3] = old[:3, :3] @ rotation.T
        pose[:3, 3] = world.scale * old[:3, 3] - pose[:3, :3] @ shift
        photos.append(dataclasses.replace(photo, camera_from_world=pose))
    points = posed.points
    if points is not None:
        moved = world.apply(torch.from_numpy(np.ascontiguousarray(points.points))).numpy()
        points = dataclasses.replace(points, points=moved)
    return dataclasses.replace(posed, photos=tuple(photos), points=points)
