"""Which parts of the smooth surface through P are gaps of P, and which of them to close.

Conventions
-----------
* Lengths are in object sizes. A region is a connected part of the surface that P does not cover.
* Through a gap one sees the backs of surfaces, which are not meant to be seen. A region through
  which one sees mostly the fronts of surfaces, or free space, is an opening.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.shape.fill.facing import TOLERANCE, Around
from gscomplete.shape.fill.indicator import CELL_SIDE, Solid
from gscomplete.splats import Splats
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.util.arrays import IntArray

Verdict = Literal["closed", "opening", "too large", "away from P"]

_MOST_PER_AXIS = 9
_COVER_SIGMAS = 1.2
"""A splat covers the surface out to so many standard deviations."""
_NEIGHBOURS = 16
_USUAL_QUANTILE, _USUAL_FACTOR = 0.8, 2.4
"""A surface point is uncovered if its distance from the nearest splat, along the surface and in
spacings of splats, exceeds a limit: the given quantile of these distances times the factor, ..."""
_LEAST_SPACINGS, _MOST_SPACINGS = 1.0, 2.5
"""... kept within these bounds. The limit adapts because scattered splats leave larger holes than
splats on a grid."""
_LEAST_GAP = 0.004
"""Spacings count as at least this, so points nearer than this to a splat are always covered."""
_CERTAIN_GAP = 3.0
"""Points at least so many spacings away lie in gaps and do not count for that quantile."""
_JOINED = 1.5 * CELL_SIDE
_FEWEST = 6
"""Smaller regions are specks of noise."""
_SAMPLES = 400
_OBLIQUE = 0.2
_UPRIGHT = 0.7
"""A region faces up or down if the z component of its mean normal exceeds this, up or down."""
_SIDE = 0.15
"""Least component of a seen normal towards (front) or away from (back) the camera."""
_MOST_AWAY = 0.03
"""A region that is nowhere nearer to P than this does not belong to P."""
_MOST_BELOW_SHARE = 0.5
"""Largest share of the surface that a region facing down may have and still be a gap: captures and
scans cannot see the side that an object stands on."""
_NARROW = 0.03
"""Narrower regions are slits; they are closed whatever is seen through them."""
_MOST_ABOVE = 0.2
"""Wider regions that face up are mouths of vessels: tops are what captures see best."""
_MOST_FRONTS = 0.4
"""Largest share of fronts close behind in what is seen through a hole; with more, it is a niche and
they are its floor."""
_LEAST_BACKS = 0.5
"""Least share of backs in what is seen through a region that is closed, unless it is a slit."""


@dataclass(frozen=True, slots=True)
class FillSettings:
    """What counts as a gap to close; lengths in object sizes."""

    count: int = 20_000
    """Most new splats."""
    most_share: float = 0.15
    """Regions with a larger share of the surface are missing parts, not gaps."""

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            ValueError: a value is out of range; the message names the field.
        """
        if self.count < 1:
            raise ValueError(f"count: expected at least 1, found {self.count}")
        if not 0 < self.most_share <= 1:
            raise ValueError(f"most_share: expected 0 to 1, not 0; found {self.most_share}")


@dataclass(frozen=True, slots=True)
class Cover:
    """Points sampled on P's splats, dense enough for gaps between splats to be found."""

    points: Tensor  # [M, 3]
    normals: Tensor  # [M, 3] outward, as long as they are sure
    owners: Tensor  # [M] index of the splat
    spacing: Tensor  # [M] mean distance to the six nearest points
    tree: cKDTree

    def areas(self) -> Tensor:  # [M]
        """Return the area of the surface that each point stands for."""
        return self.spacing.square()


@dataclass(frozen=True, slots=True)
class Region:
    """A connected part of the surface that P does not cover."""

    points: Tensor  # [K, 3]
    normals: Tensor  # [K, 3]
    width: float
    """Twice the largest distance of its points from P's splats."""
    share: float
    """Its share of the surface."""
    is_below: bool
    """Whether it faces down, as the side that the object stands on does."""
    backs: float | None
    """Share of backs of surfaces in what is seen through it; None = it is seen from nowhere."""
    verdict: Verdict


def cover_of(splats: Splats, normals: Tensor) -> Cover:  # [N, 3]
    """Return points on P's splats.

    Args:
        splats: P in the object frame.
        normals: of the splats, outward.
    """
    order = splats.scales.argsort(dim=1, descending=True)
    matrices = rotation_matrices(splats.quaternions).transpose(1, 2)
    along = matrices.gather(1, order[:, :2, None].expand(-1, -1, 3))
    along = _COVER_SIGMAS * along * splats.scales.gather(1, order)[:, :2, None]
    per_axis = (2 * along.norm(dim=2).amax(dim=1) / CELL_SIDE).ceil().clamp(1, _MOST_PER_AXIS)
    points, owners = [], []
    for number in range(1, _MOST_PER_AXIS + 1):
        rows = torch.nonzero(per_axis == number)[:, 0]
        steps = (torch.arange(number) + 0.5) / number * 2 - 1
        grid = torch.cartesian_prod(steps, steps).reshape(-1, 2)
        offsets = (grid[None, :, :, None] * along[rows][:, None]).sum(dim=2)
        points.append((splats.means[rows][:, None] + offsets).reshape(-1, 3))
        owners.append(rows.repeat_interleave(len(grid)))
    place, owner = torch.cat(points).float(), torch.cat(owners)
    tree = cKDTree(place.numpy())
    distance, _ = tree.query(place.numpy(), k=range(2, 8))
    spacing = torch.from_numpy(np.nan_to_num(distance, posinf=0.0).mean(axis=1)).float()
    return Cover(place, normals[owner], owner, spacing, tree)


def distances(
    cover: Cover,
    points: Tensor,  # [N, 3]
    normals: Tensor,  # [N, 3]
) -> tuple[Tensor, Tensor]:  # [N], [N]
    """Return how far surface points are from P's splats, along the surface.

    Args:
        cover: of P.
        points: on the surface.
        normals: of the surface there.

    Returns:
        Distances in object sizes, and in spacings of the splats there (at least ``_LEAST_GAP``).
    """
    number = min(_NEIGHBOURS, len(cover.points))
    _, index = cover.tree.query(points.numpy(), k=number)
    near = torch.from_numpy(np.asarray(index).reshape(len(points), -1))
    offsets = cover.points[near] - points[:, None]
    offsets = offsets - (offsets * normals[:, None]).sum(dim=2, keepdim=True) * normals[:, None]
    distance = offsets.norm(dim=2).amin(dim=1)
    spacing = cover.spacing[near].median(dim=1).values.clamp_min(_LEAST_GAP)
    return distance, distance / spacing


def _spacings_of_gaps(in_spacings: Tensor) -> float:  # [N]
    """Return the number of spacings beyond which a surface point is uncovered."""
    usual = in_spacings[in_spacings < _CERTAIN_GAP]
    if not len(usual):
        return _LEAST_SPACINGS
    typical = float(np.quantile(usual.numpy(), _USUAL_QUANTILE))
    return min(max(_USUAL_FACTOR * typical, _LEAST_SPACINGS), _MOST_SPACINGS)


def find_regions(
    solid: Solid,
    cover: Cover,
    around: Around,
    facing: Tensor,  # [V, S, S, 3] as pictures_of_normals gives
    settings: FillSettings,
) -> list[Region]:
    """Return the regions of the surface that P does not cover, with verdicts, the largest first.

    Args:
        solid: a solid whose surface follows P.
        cover: points on P's splats.
        around: P's pictures from all round.
        facing: the normals seen in these pictures.
        settings: what counts as a gap.
    """
    cells = solid.crossed_cells()
    points, normals, arrived = solid.project(cells)
    points, normals = points[arrived], normals[arrived]
    distance, in_spacings = distances(cover, points, normals)
    open_ = in_spacings > _spacings_of_gaps(in_spacings)
    points, normals, distance = points[open_], normals[open_], distance[open_]
    if not len(points):
        return []
    labels = components(points.numpy(), _JOINED)
    regions = []
    for label in np.flatnonzero(np.bincount(labels) >= _FEWEST):
        rows = torch.from_numpy(np.flatnonzero(labels == label))
        part, outward = points[rows], normals[rows]
        backs = _share_of_backs(part, outward, around, facing)
        width, share = 2 * float(distance[rows].max()), len(rows) / len(cells)
        up = float(outward[:, 2].mean())
        is_below = up < -_UPRIGHT
        most = _MOST_BELOW_SHARE if is_below else settings.most_share
        verdict: Verdict = "closed"
        if float(distance[rows].min()) > _MOST_AWAY:
            verdict = "away from P"
        elif share > most:
            verdict = "too large"
        elif _is_opening(width, up, backs):
            verdict = "opening"
        regions.append(Region(part, outward, width, share, is_below, backs, verdict))
    return sorted(regions, key=lambda region: -region.share)


def _is_opening(width: float, up: float, backs: float | None) -> bool:
    """Tell whether a region is meant to be open."""
    if width > _MOST_ABOVE and up > _UPRIGHT:
        return True
    return width > _NARROW and (backs is None or backs < _LEAST_BACKS)


def components(points: NDArray[np.floating], reach: float) -> IntArray:  # [N, 3] -> [N]
    """Return the connected component of every point."""
    pairs = cKDTree(points).query_pairs(reach, output_type="ndarray")
    ones = np.ones(len(pairs), np.bool_)
    graph = coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
    _, labels = connected_components(graph, directed=False)
    return labels.astype(np.int64)


def _share_of_backs(
    points: Tensor,  # [K, 3]
    normals: Tensor,  # [K, 3]
    around: Around,
    facing: Tensor,  # [V, S, S, 3]
) -> float | None:
    """Return the share of backs in what is seen through a region; None = no camera sees it."""
    step = max(1, len(points) // _SAMPLES)
    points, normals = points[::step], normals[::step]
    backs = others = 0
    for view in range(len(around.cameras)):
        ways = around.ways(points, view)
        row, column, far = around.pixels(points, view)
        outside = (normals * ways).sum(dim=1) > _OBLIQUE
        alpha, depth = around.alpha[view, row, column], around.depth[view, row, column]
        behind = outside & (alpha > 0.5) & (depth > far + TOLERANCE)
        toward = (facing[view, row, column] * ways).sum(dim=1)
        backs += int((behind & (toward < -_SIDE)).sum())
        others += int((behind & (toward > _SIDE)).sum()) + int((outside & (alpha < 0.5)).sum())
    return backs / (backs + others) if backs + others else None


def is_hidden_or_recess(
    points: Tensor,  # [K, 3]
    normals: Tensor,  # [K, 3]
    width: float,
    around: Around,
    facing: Tensor,  # [V, S, S, 3]
) -> bool:
    """Tell whether a lid would be hidden by P, or cover a recess no deeper than its own width.

    Args:
        points: of the lid.
        normals: of the lid's points.
        width: of the lid, object sizes.
        around: P's pictures from all round.
        facing: the normals seen in these pictures.
    """
    step = max(1, len(points) // _SAMPLES)
    points, normals = points[::step], normals[::step]
    outside = hidden = fronts = 0
    for view in range(len(around.cameras)):
        ways = around.ways(points, view)
        row, column, far = around.pixels(points, view)
        alpha, depth = around.alpha[view, row, column], around.depth[view, row, column]
        here = (normals * ways).sum(dim=1) > _OBLIQUE
        behind = here & (alpha > 0.5) & (depth > far + TOLERANCE)
        toward = (facing[view, row, column] * ways).sum(dim=1)
        outside += int(here.sum())
        hidden += int((here & (alpha > 0.5) & ~behind).sum())
        fronts += int((behind & (depth < far + width) & (toward > _SIDE)).sum())
    return 2 * hidden > outside or fronts > _MOST_FRONTS * (outside - hidden)
