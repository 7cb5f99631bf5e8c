"""Photos with known cameras: what every source of poses is read into.

Conventions
-----------
* ``camera_from_world`` is float64 with OpenCV axes (x right, y down, z forward). The world frame
  is the source's own; nothing is turned, centred or scaled.
* A photo's name is its path within the folder that holds all photos: the plain file name where
  they lie in one folder, ``left/0001.png`` where they do not. No two files share one.
* Photos are sorted by name, so that an order means the same in every source.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gscomplete.errors import UserError
from gscomplete.util.arrays import Float64Array
from splatcomplete_data.multiview.photos.lens import Lens
from splatcomplete_data.scan import PointCloud

FEWEST_PHOTOS = 3
"""With fewer there is nothing to train on."""


@dataclass(frozen=True, slots=True)
class PosedPhoto:
    """One photo and the camera that took it."""

    path: Path
    lens: Lens
    camera_from_world: Float64Array  # [4, 4]
    mask_path: Path | None = None  # None = the photo has no mask of its own


@dataclass(frozen=True, slots=True)
class PosedPhotos:
    """A capture: photos with cameras, and a sparse cloud if the source has one."""

    photos: tuple[PosedPhoto, ...]
    points: PointCloud | None
    source: str  # what gave the poses, for records
    notes: tuple[str, ...] = ()  # what was left out, and why

    def __post_init__(self) -> None:
        """Check that there is something to train on.

        Raises:
            UserError: fewer than three photos, or a pose that is not a rigid motion.
        """
        if len(self.photos) < FEWEST_PHOTOS:
            left_out = "".join(f"; {note}" for note in self.notes)
            raise UserError(
                f"{self.source}: expected at least {FEWEST_PHOTOS} photos with cameras, found "
                f"{len(self.photos)}{left_out}"
            )
        for photo, name in zip(self.photos, self.names, strict=True):
            rotation = photo.camera_from_world[:3, :3]
            error = np.abs(rotation @ rotation.T - np.eye(3)).max()
            if not (error < 1e-3 and np.linalg.det(rotation) > 0):
                raise UserError(
                    f"{self.source}: pose of {name}: expected a rotation and a "
                    f"translation, found a matrix that stretches or mirrors (by {error:.2g})"
                )

    @property
    def folder(self) -> Path:
        """The deepest folder that holds all photos; symbolic links are not followed."""
        parents = {os.path.abspath(photo.path.parent) for photo in self.photos}
        return Path(os.path.commonpath(sorted(parents)))

    @property
    def names(self) -> tuple[str, ...]:
        """What the photos are called: their paths within ``folder``, with slashes."""
        folder = self.folder
        paths = [Path(os.path.abspath(photo.path)) for photo in self.photos]
        return tuple(path.relative_to(folder).as_posix() for path in paths)

    @property
    def positions(self) -> Float64Array:  # [V, 3]
        """Camera centres in world coordinates."""
        matrices = np.stack([photo.camera_from_world for photo in self.photos])
        return -np.einsum("vji,vj->vi", matrices[:, :3, :3], matrices[:, :3, 3])

    @property
    def forwards(self) -> Float64Array:  # [V, 3]
        """Unit viewing directions in world coordinates."""
        return np.stack([photo.camera_from_world[2, :3] for photo in self.photos])

    def look_at(self) -> Float64Array:  # [3]
        """Return the point closest to all optical axes: what the cameras look at.

        Parallel axes have no such point; the normal equations are then solved in the least-norm
        sense about the mean position, which keeps the result finite.
        """
        positions, forwards = self.positions, self.forwards
        across = np.eye(3) - forwards[:, :, None] * forwards[:, None, :]
        middle = positions.mean(axis=0)
        pull = np.einsum("vij,vj->i", across, positions - middle)
        return middle + np.linalg.lstsq(across.sum(axis=0), pull, rcond=1e-6)[0]

    def extent(self) -> float:
        """Return 1.1 times the largest distance of a camera from their mean (as 3DGS does)."""
        positions = self.positions
        reach = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
        return 1.1 * reach if reach > 0 else 1.0
