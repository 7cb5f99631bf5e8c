"""Long objects, shortened for the shape network.

The network's cells are cubes, and an object's largest side spans the grid: a pole is a few cells
thick, and an error of one cell is a fifth of its width. A long object is therefore completed in a
frame in which it is shortened along its long axis and enlarged, and the new splats are stretched
back. The network was trained on stretched objects, and most of what is long (tools, bottles, posts)
remains plausible when it is shortened.

Conventions
-----------
* Extents are those of P and of its reflection through the origin, the guessed centre of the
  complete object: the part that is missing is expected there.
* The long axis is upright, or level and along the direction in which P varies most.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import torch

from gscomplete.shape.mirror_plane import Mirror, MirrorPlane
from gscomplete.splats import Splats
from gscomplete.splats.transform import stretch_splats
from gscomplete.util.arrays import Float64Array
from gscomplete.views import ViewDistribution

_LONG = 0.44
"""P is long if its second extent over its first is smaller ..."""
_SHORTENED_TO = 0.55
"""... and is then shortened until they have this ratio."""
_LEAST_FACTOR = 0.25
"""Nothing is shortened more than to this."""


@dataclass(frozen=True, slots=True)
class Shortening:
    """The map x -> scale * (x + (factor - 1) (axis . x) axis), from the object frame."""

    axis: Float64Array  # [3] unit, upright or level
    factor: float
    """Of lengths along the axis, in (0, 1)."""
    scale: float
    """Of all lengths thereafter: the largest extent is 1 again."""

    @property
    def note(self) -> str:
        """What is done, for the user."""
        return f"P is long: it is completed shortened to {self.factor:.0%} of its length"

    @property
    def matrix(self) -> Float64Array:  # [3, 3]
        """The map as a matrix."""
        along = np.outer(self.axis, self.axis)
        return self.scale * (np.eye(3) + (self.factor - 1) * along)

    def splats(self, splats: Splats) -> Splats:
        """Return splats of the object frame in the shortened one."""
        return stretch_splats(splats, torch.from_numpy(self.matrix))

    def splats_back(self, splats: Splats) -> Splats:
        """Return splats of the shortened frame in the object frame."""
        return stretch_splats(splats, torch.from_numpy(np.linalg.inv(self.matrix)))

    def views(self, views: ViewDistribution) -> ViewDistribution:
        """Return V in the shortened frame: as far away, from where c is carried to."""
        x, y, z = self.matrix @ views.direction()
        target = (self.matrix @ np.array(views.target)).tolist()
        return dataclasses.replace(
            views,
            azimuth_deg=math.degrees(math.atan2(y, x)),
            elevation_deg=math.degrees(math.atan2(z, math.hypot(x, y))),
            target=(target[0], target[1], target[2]),
        )

    def mirror(self, mirror: Mirror) -> Mirror | None:
        """Return what P is to be mirrored through there; None = the plane is none of symmetry."""
        if not isinstance(mirror, MirrorPlane):
            return mirror
        offset = mirror.offset * self.scale
        if self.axis[2] < 1 or abs(offset) > 1:
            return None
        return MirrorPlane(mirror.azimuth_deg, offset)

    def plane_back(self, plane: MirrorPlane) -> MirrorPlane:
        """Return a plane of the shortened frame in the object frame."""
        angle = math.radians(plane.azimuth_deg)
        normal = self.matrix.T @ np.array([math.cos(angle), math.sin(angle), 0.0])
        length = float(np.linalg.norm(normal))
        azimuth_deg = math.degrees(math.atan2(normal[1], normal[0]))
        offset = min(max(plane.offset / length, -1.0), 1.0)
        return MirrorPlane(round(azimuth_deg, 1), round(offset, 3))


def shortening_of(
    points: Float64Array,  # [N, 3] P, object frame
    *,
    ends_in_plane: bool,
) -> Shortening | None:
    """Return how P is shortened; None = it is not.

    Args:
        points: P's points.
        ends_in_plane: whether P was cut along a plane. Then its own splats are likely to be
            mirrored, and a mirror image stays one only if the long axis is upright.
    """
    if len(points) < 2:
        return None
    level = points[:, :2] - points[:, :2].mean(axis=0)
    x, y = np.linalg.eigh(level.T @ level)[1][:, 1]
    along = np.array([[0.0, 0.0, 1.0], [x, y, 0.0], [-y, x, 0.0]])
    extents = 2 * np.abs(points @ along.T).max(axis=0)
    _, second, first = np.sort(extents)
    longest = int(extents.argmax())
    if not 0 < second < _LONG * first or longest == 2 or (ends_in_plane and longest > 0):
        return None
    factor = max(second / first / _SHORTENED_TO, _LEAST_FACTOR)
    return Shortening(along[longest], float(factor), float(1 / max(factor * first, second)))
