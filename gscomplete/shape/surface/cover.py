"""Cover the surface that the shape network predicts with splats.

Conventions
-----------
* The surface is where the interpolated occupancy logit crosses a level. The logit falls outward.
  The network fills the cells of thin walls whole, so the predicted surface lies about ``_INWARD``
  cells outside the true one. Whether a point is new is decided ``_INWARD`` cells inside the
  predicted surface; its splat is then placed at the depth that ``depth`` predicts.
* Splats are flat discs facing outward, evenly spread. There are none where P has surface already,
  by its centres and, if it is known all around, by what it shows (``solid``).
* Where P is part of a surface of revolution, P turned about its axis (``turned``) takes the place
  of the predicted surface. It is exact, so it is covered with smaller splats, at its own depth.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.shape.colors.bands import with_bands
from gscomplete.shape.colors.rim import checked_by_rim
from gscomplete.shape.colors.sources import nearest_colors, source_colors
from gscomplete.shape.network import ShapeOutput
from gscomplete.shape.partial_voxels import ShapeInputs
from gscomplete.shape.surface.depth import surface_depths
from gscomplete.shape.surface.solid import SolidViews
from gscomplete.shape.surface.turned import TurnedSurface
from gscomplete.shape.voxels import CELL_SIDE, HALF_SIDE, grown, sample_volume
from gscomplete.splats import Splats, colors_to_sh, concatenate
from gscomplete.splats.geometry.nearest import query_nearest
from gscomplete.splats.geometry.neighbourhood import one_sidedness
from gscomplete.splats.geometry.poisson_disk import poisson_disk_sample
from gscomplete.splats.rotations import quaternions_facing
from gscomplete.splats.thinning import thinned

_INWARD = 1.0
"""Cells. Of the values 0.3 to 1.3, 0.9 to 1.1 give the best silhouettes on 45 parts of 15 real
objects that no benchmark uses: .005 better than 0.6 at 256 px, .004 at 128 px and .002 at 64 px
(standard error .002)."""
_INWARD_STEPS = 4
"""On the way inside, slopes are checked after each of so many equal steps."""
_SEEDS_PER_CELL = 24
"""So many that there is a point to choose everywhere on the surface; with 6, cracks showed at
512 px."""
_NEWTON_STEPS = 5
_FLATNESS = 0.1
_RIM_NEIGHBOURS = 12
_LEAST_GAP = 0.004
"""Gaps narrower than this do not show, object sizes."""
_ROUNDING = 1e-3
"""A splat's distance is never less than its distance along the surface, except by a rounding
error, whose share is smaller than this."""
_COPY_REACH = 1.2
"""A point belongs on a mirror image of P that is within this distance, cells."""
_COPY_NEIGHBOURS = 4
_OPACITY = 0.95
_OVERLAP, _TURNED_OVERLAP = 1.45, 0.9
"""Tangent standard deviation per spacing, so that neighbours overlap into a closed surface; smaller
beside a turned surface, whose outline is known."""
_TURNED_SINK = 0.5
"""Splats of a turned surface lie so many spacings below it: their width would widen outlines."""
_TURNED_SPACINGS = 2.45
"""Splats are at least so many median distances between its places apart, so that there is a place
to choose wherever there is room for a splat."""
_TURNED_COUNT = 30_000
"""Most splats beside a turned surface."""


@dataclass(frozen=True, slots=True)
class SurfaceSettings:
    """How the surface is covered; lengths in object sizes."""

    count: int = 8000
    """Most splats."""
    near_partial: float = 0.03
    """Surface points within this distance of P's splats are P's own, ..."""
    near_rim: float = 0.007
    """... unless they lie beyond P's rim. There only points within this distance are P's own, so
    that no gap shows."""
    one_sided: float = 0.7
    """A point lies beyond the rim if the ``one_sidedness`` of P's nearest splats is larger."""
    gap_spacings: float | None = None
    """A point lies in a gap if no splat is within so many spacings of the splats, measured along
    the surface. It is then new, however near splats are; None = gaps are left as they are."""
    least_spacing: float = 0.0013
    """Splats are at least this far apart, even if fewer than ``count`` are placed."""
    filled_logit: float = -1.0
    """Cells with at least this logit count as filled; ``assemble.AssembleSettings`` has the level
    for complete objects."""
    rim_decides: bool = False
    """Whether colours that differ from those at P's rim are replaced by them."""


@dataclass(frozen=True, slots=True)
class SurfacePoints:
    """Points of the predicted surface, evenly spread."""

    points: Tensor  # [N, 3] where the logits cross their level
    normals: Tensor  # [N, 3] outward
    insets: Tensor  # [N] how far inside it was decided that they are new
    spacing: float  # least distance of two that face the same way
    is_turned: Tensor  # [N] bool P turned about its axis, not predicted


def surface_splats(
    output: ShapeOutput,
    inputs: ShapeInputs,
    partial: Splats,
    settings: SurfaceSettings,
    generator: torch.Generator,
    mirrored: Splats | None = None,
    turned: TurnedSurface | None = None,
    solid: SolidViews | None = None,
) -> Splats:
    """Return splats that cover the surface of one object where P does not.

    Args:
        output: of the network for a batch of one.
        inputs: what the network saw.
        partial: P in the object frame: surface that exists already, and colours.
        settings: knobs.
        generator: chooses where splats are placed.
        mirrored: further splats that exist already and are a source of colours; None = none.
        turned: the surface of revolution that P is part of; None = there is none.
        solid: where splats that exist show solid surface; None = as far as their centres tell.
    """
    anchor = thinned(partial, 20_000, generator)
    there = anchor.means
    if mirrored is not None:
        there = torch.cat([there, mirrored.means])
        if turned is not None:
            asked = turned.points, turned.normals, mirrored.means, SurfaceSettings()
            turned = turned.beside_copies(is_missing(*asked))
    if turned is not None:
        spacing = max(_TURNED_SPACINGS * turned.spacing(), settings.least_spacing)
        settings = dataclasses.replace(settings, count=_TURNED_COUNT, least_spacing=spacing)
    found = new_surface(output, there, settings, generator, turned, solid)
    points, normals = found.points, found.normals
    predicted, facing = points[~found.is_turned], normals[~found.is_turned]
    depths = surface_depths(output, inputs, settings.filled_logit, predicted, facing)
    predicted = on_copies(predicted - depths[:, None] * facing, facing, anchor.means, inputs)
    points = points - _TURNED_SINK * found.spacing * normals
    points[~found.is_turned] = predicted
    is_turned = found.is_turned
    if solid is not None:
        kept = ~solid.cover(points)
        points, normals, is_turned = points[kept], normals[kept], is_turned[kept]
    if mirrored is None:
        colors, sure = torch.zeros_like(points), torch.zeros(len(points))
        its = source_colors(output, inputs, partial, points[~is_turned], generator)
        colors[~is_turned], sure[~is_turned] = its
        if turned is not None and bool(is_turned.any()):
            # Beside the inner side of a thin wall, what lies a little outside is the outer one's.
            places = (points + CELL_SIDE * normals)[is_turned]
            body = turned.colored_by(partial)
            its = source_colors(output, inputs, body, places, generator)
            colors[is_turned], sure[is_turned] = its
        if settings.rim_decides:
            colors = checked_by_rim(colors, sure, points, normals, partial, generator)
        if turned is not None:
            about = points[is_turned], normals[is_turned], partial
            bands = with_bands(colors[is_turned], *about, turned.body, turned.revolution.axis)
            colors[is_turned] = bands
    else:
        colored = concatenate([partial.with_sh_degree(0), mirrored])
        colors = nearest_colors(colored, points, normals, generator)
    overlap = _OVERLAP if turned is None else _TURNED_OVERLAP
    scales = torch.full((len(points), 3), overlap * found.spacing)
    scales[:, 2] *= _FLATNESS
    return Splats(
        points,
        quaternions_facing(normals),
        scales,
        torch.full((len(points),), _OPACITY),
        colors_to_sh(colors.clamp(0.0, 1.0)),
    )


def new_surface(
    output: ShapeOutput,
    there: Tensor,  # [M, 3]
    settings: SurfaceSettings,
    generator: torch.Generator,
    turned: TurnedSurface | None = None,
    solid: SolidViews | None = None,
) -> SurfacePoints:
    """Return the surface where there are no splats yet: turned where it can be, else predicted.

    Args:
        output: of the network for a batch of one.
        there: centres of the splats that exist already.
        settings: knobs.
        generator: chooses where points lie.
        turned: the surface of revolution that P is part of; None = there is none.
        solid: where splats that exist show solid surface; None = as far as their centres tell.
    """
    logits = (output.occupancy[0].float() - settings.filled_logit).clamp(-8, 8)
    field = _field(logits)
    points, normals, on_surface = _project(field, _seeds(logits, generator))
    points, normals = points[on_surface], normals[on_surface]
    insets = _insets(field, points, normals)
    inside = points - insets[:, None] * normals
    if turned is not None:
        there = torch.cat([there, turned.points])
        about = 0.5 * (points + inside)  # about where splats are placed
        body = turned.against_body(about, normals)
        free = ~(body.contradicts | body.repeats)
        inside, points, normals, insets = (x[free] for x in (inside, points, normals, insets))
    is_new = is_missing(inside, normals, there, settings)
    if solid is not None:
        is_new[is_new.clone()] = ~solid.cover(inside[is_new])
    inside, points, normals = inside[is_new], points[is_new], normals[is_new]
    insets = insets[is_new]
    count = len(points)
    if turned is not None:
        inside, points = (torch.cat([own, turned.points]) for own in (inside, points))
        normals = torch.cat([normals, turned.normals])
        insets = torch.cat([insets, torch.zeros(len(turned.points))])
    asked = inside.double().numpy(), normals.double().numpy()
    rows, spacing = poisson_disk_sample(*asked, settings.count, settings.least_spacing)
    kept = torch.from_numpy(rows)
    return SurfacePoints(points[kept], normals[kept], insets[kept], spacing, kept >= count)


def on_copies(
    points: Tensor,  # [N, 3]
    normals: Tensor,  # [N, 3]
    others: Tensor,  # [M, 3] P's splats
    inputs: ShapeInputs,
) -> Tensor:  # [N, 3]
    """Move points along their normals onto the mirror image of P that passes near them, if any.

    Cells are coarse. Where the network follows a mirror image, the image's splats show exactly
    where the surface is. If two images are near, the likelier one counts.
    """
    tree = cKDTree(others.numpy())
    moved, free = points.clone(), torch.arange(len(points))
    nearest = range(1, min(_COPY_NEIGHBOURS, len(others)) + 1)
    reach = _COPY_REACH * CELL_SIDE
    for symmetry in inputs.symmetries:
        # Neighbours beyond the bound are returned as infinitely far, which makes queries faster.
        distance, index = tree.query(
            symmetry.undo(points[free].numpy()), k=nearest, distance_upper_bound=reach
        )
        is_near = np.isfinite(distance).all(axis=1)
        near, index = free[torch.from_numpy(is_near)], index[is_near]
        flat = symmetry.apply(others.numpy()[index.reshape(-1)])
        copies = torch.from_numpy(flat).reshape(*index.shape, 3)
        along = ((copies - points[near, None]) * normals[near, None]).sum(dim=2)
        is_flat = along.amax(dim=1) - along.amin(dim=1) < CELL_SIDE
        used = near[is_flat]
        moved[used] += along.mean(dim=1)[is_flat, None] * normals[used]
        free = free[~torch.isin(free, used, assume_unique=True)]
    return moved


def _seeds(logits: Tensor, generator: torch.Generator) -> Tensor:  # [N, 3]
    """Draw points in the cells on both sides of the surface."""
    filled = (logits > 0).float()[None]
    mixed = grown(filled) - (1 - grown(1 - filled))
    cells = torch.nonzero(mixed[0] > 0).repeat_interleave(_SEEDS_PER_CELL, dim=0).float()
    jitter = torch.rand(cells.shape, generator=generator)
    return (cells + jitter) * CELL_SIDE - HALF_SIDE


def _field(logits: Tensor) -> Tensor:  # [C, C, C] -> [4, C, C, C]
    """Return the mean of the logits and the smoothed logits, and its slopes."""
    smooth = F.avg_pool3d(logits[None], 3, 1, 1, count_include_pad=False)[0]
    field = 0.5 * (logits + smooth)
    return torch.stack([field, *torch.gradient(field, spacing=CELL_SIDE)])


def _project(field: Tensor, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Move points to the surface; return them, outward normals, and which ones arrived."""
    home = points
    for _ in range(_NEWTON_STEPS):
        found = sample_volume(field, points)
        slope = found[:, 1:]
        move = -found[:, :1] * slope / slope.square().sum(dim=1, keepdim=True).clamp_min(1e-3)
        points = points + move.clamp(-CELL_SIDE, CELL_SIDE)
    found = sample_volume(field, points)
    normals = -F.normalize(found[:, 1:], dim=1)
    steep = found[:, 1:].norm(dim=1).clamp_min(1e-3)
    arrived = (found[:, 0].abs() / steep < 0.1 * CELL_SIDE) & (
        (points - home).norm(dim=1) < 2.5 * CELL_SIDE
    )
    return points, normals, arrived


def _insets(field: Tensor, points: Tensor, normals: Tensor) -> Tensor:  # [N]
    """Return how far inside each point to decide whether it is new.

    This is ``_INWARD`` cells, or up to the axis of a thinner rod, beyond which the logits fall.
    """
    step = _INWARD / _INWARD_STEPS * CELL_SIDE
    insets, rises = torch.zeros(len(points)), torch.ones(len(points), dtype=torch.bool)
    for _ in range(_INWARD_STEPS):
        insets = torch.where(rises, insets + step, insets)
        slopes = sample_volume(field[1:], points - insets[:, None] * normals)
        rises = rises & ((slopes * normals).sum(dim=1) <= 0)
    return insets


def is_missing(
    points: Tensor,  # [N, 3]
    normals: Tensor,  # [N, 3]
    others: Tensor,  # [M, 3]
    settings: SurfaceSettings,
) -> Tensor:  # [N] bool
    """Mark the points of a surface that are far from other points, beyond their rim or in a gap.

    Beyond the rim the nearest of the others all lie to one side; within their surface they lie all
    around. This is computed only for points near others, and only where it can change the result.

    Args:
        points: of the surface.
        normals: outward normals of the points.
        others: points of the surface that exists already.
        settings: limits.
    """
    tree = cKDTree(others.numpy())
    # Neighbours beyond the bound are returned as infinitely far, which makes queries faster.
    within = math.nextafter(settings.near_partial, math.inf)
    distance, _ = query_nearest(tree, points.numpy(), within=within)
    missing = torch.from_numpy(distance > settings.near_partial)
    widest = math.inf
    if settings.gap_spacings is not None:
        widest = max(settings.gap_spacings * median_spacing(others), _LEAST_GAP)
    asked = distance > min(settings.near_rim, (1.0 - _ROUNDING) * widest)
    close = torch.nonzero(~missing & torch.from_numpy(asked))[:, 0]
    if not len(close):
        return missing
    points, normals = points[close], normals[close]
    nearest = range(1, min(_RIM_NEIGHBOURS, len(others)) + 1)
    distance, index = query_nearest(tree, points.numpy(), nearest)
    offsets = others[torch.from_numpy(index)] - points[:, None]
    along = (offsets * normals[:, None]).sum(dim=2, keepdim=True)
    offsets = offsets - along * normals[:, None]
    one_sided = torch.from_numpy(one_sidedness(offsets.numpy()) > settings.one_sided)
    missing[close] = one_sided & (torch.from_numpy(distance[:, 0]) > settings.near_rim)
    missing[close] |= offsets.norm(dim=2).amin(dim=1) > widest
    return missing


def median_spacing(points: Tensor) -> float:  # [N, 3]
    """Return the median distance of points from their nearest neighbours; 0 for less than two."""
    if len(points) < 2:
        return 0.0
    distance, _ = cKDTree(points.numpy()).query(points.numpy(), k=2)
    return float(np.median(distance[:, 1]))
