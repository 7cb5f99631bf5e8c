"""Close the gaps of a complete object: the new splats lie in its gaps and nowhere else.

Conventions
-----------
* The object frame; lengths are in object sizes. Nothing is added outside P's box.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.shape.fill.bridges import bridged
from gscomplete.shape.fill.facing import Around, look_around, outward_normals, pictures_of_normals
from gscomplete.shape.fill.gaps import (
    Cover,
    FillSettings,
    Region,
    Verdict,
    cover_of,
    distances,
    find_regions,
    is_hidden_or_recess,
)
from gscomplete.shape.fill.indicator import CELL_SIDE, Solid, solid_through
from gscomplete.splats import Splats, colors_to_sh, concatenate
from gscomplete.splats.rotations import quaternions_facing, rotation_matrices
from gscomplete.util.same_bits import fixed_sum

_POINTS_PER_CELL = 40
_SEAM_SPACINGS = 0.8
"""New splats keep at least so many spacings away from P's."""
_LEAST_SPACING, _MOST_SPACING = 0.003, 0.012
_OVERLAP = 0.8
"""Tangent standard deviation per spacing, so that neighbours overlap into a closed surface."""
_FLATNESS = 0.1
_OPACITY = 0.95
_RIM_NEIGHBOURS = 24
_SPACING_NEIGHBOURS = 5
_MOSTLY = 0.5


@dataclass(frozen=True, slots=True)
class Filled:
    """What closes P's gaps."""

    splats: Splats
    regions: tuple[Region, ...]
    """Every part of the surface that P does not cover, closed or left."""

    @property
    def note(self) -> str:
        """What was closed and what was left, for the user."""
        closed = [region for region in self.regions if region.verdict == "closed"]
        left = Counter(region.verdict for region in self.regions if region.verdict != "closed")
        text = f"fill: {len(closed)} gaps closed by {len(self.splats):,} splats"
        if closed:
            text += f", the widest {max(region.width for region in closed):.3f} object sizes"
            text += f", {100 * sum(region.share for region in closed):.1f} % of the surface"
        if left:
            text += "; left: " + ", ".join(f"{count} {name}" for name, count in left.items())
        return text


def close_gaps(
    partial: Splats, generator: torch.Generator, settings: FillSettings | None = None
) -> Filled:
    """Return splats that close the gaps of an object that is complete but for them.

    Args:
        partial: P in the object frame.
        generator: chooses where splats sit.
        settings: what counts as a gap; None = defaults.
    """
    chosen = settings or FillSettings()
    around = look_around(partial)
    normals = outward_normals(partial, around)
    cover = cover_of(partial, normals)
    solid = solid_through(cover.points, cover.normals, cover.areas())
    facing = pictures_of_normals(partial, normals, around)
    regions = find_regions(solid, cover, around, facing, chosen)
    closed = [region for region in regions if region.verdict == "closed"]
    splats = partial.select(torch.arange(0)).with_sh_degree(0)
    if closed:
        splats = _splats_in(closed, solid, cover, partial, chosen, generator)
    bridges, patches = _bridges(splats, cover, partial, chosen, around, facing)
    left = [region for region in regions if not _is_covered(region, bridges)]
    return Filled(concatenate([splats, bridges]), (*left, *patches))


def _bridges(
    new: Splats,
    cover: Cover,
    partial: Splats,
    settings: FillSettings,
    around: Around,
    facing: Tensor,  # [V, S, S, 3]
) -> tuple[Splats, list[Region]]:
    """Cover the holes of thin walls, which no solid has, with splats."""
    ways = rotation_matrices(new.quaternions)[:, :, 2]
    points, normals = torch.cat([cover.points, new.means]), torch.cat([cover.normals, ways])
    number = min(_SPACING_NEIGHBOURS, len(partial))
    near, _ = cKDTree(partial.means.numpy()).query(partial.means.numpy(), k=number)
    spacing = float(np.median(np.atleast_2d(near)[:, 1:].mean(axis=1))) if number > 1 else 0.0
    total = float(fixed_sum(cover.areas().double()))
    splats, regions = [partial.select(torch.arange(0)).with_sh_degree(0)], []
    room = settings.count - len(new)
    for patch in bridged(points, normals, spacing):
        if is_hidden_or_recess(patch.points, patch.normals, patch.width, around, facing):
            continue
        share = len(patch.points) * patch.spacing**2 / max(total, 1e-12)
        is_closed = share <= settings.most_share and len(patch.points) <= room
        verdict: Verdict = "closed" if is_closed else "too large"
        regions.append(
            Region(patch.points, patch.normals, patch.width, share, False, None, verdict)
        )
        if is_closed:
            room -= len(patch.points)
            rim = _rim_of(patch.points, patch.normals, cover)
            splats.append(
                _splats_at(patch.points, patch.normals, patch.spacing, rim, partial, cover)
            )
    return concatenate(splats), regions


def _is_covered(region: Region, splats: Splats) -> bool:
    """Tell whether splats close most of a region that was left open."""
    if region.verdict == "closed" or not len(splats):
        return False
    away, _ = cKDTree(splats.means.numpy()).query(region.points.numpy())
    return bool((away < 2 * CELL_SIDE).mean() > _MOSTLY)


def _splats_in(
    regions: list[Region],
    solid: Solid,
    cover: Cover,
    partial: Splats,
    settings: FillSettings,
    generator: torch.Generator,
) -> Splats:
    """Cover regions with splats."""
    middles = torch.cat([region.points for region in regions])
    jitter = torch.rand(len(middles), _POINTS_PER_CELL, 3, generator=generator) - 0.5
    seeds = (middles[:, None] + 3 * CELL_SIDE * jitter).reshape(-1, 3)
    points, normals, arrived = solid.project(seeds)
    points, normals = points[arrived], normals[arrived]
    _, in_spacings = distances(cover, points, normals)
    distance, owner = cKDTree(middles.numpy()).query(points.numpy())
    is_below = torch.cat(
        [torch.full((len(region.points),), region.is_below) for region in regions]
    )[torch.from_numpy(owner)]
    kept = (in_spacings > _SEAM_SPACINGS) & torch.from_numpy(distance < 2 * CELL_SIDE)
    points, normals, is_below = points[kept], normals[kept], is_below[kept]
    _, nearest = cover.tree.query(points.numpy())
    spacing = float(cover.spacing[torch.from_numpy(nearest)].median()) if len(points) else 0.0
    spacing = min(max(spacing, _LEAST_SPACING), _MOST_SPACING)
    rows, spacing = _spread(points, spacing, settings.count)
    points, normals, is_below = points[rows], normals[rows], is_below[rows]
    rim = _rim_of(points, normals, cover)
    points = points + rim.mean(solid.height(cover.points)[:, None]) * normals
    level = rim.mean(cover.points[:, 2:])[:, 0]  # what an object stands on does not sag into it
    points[:, 2] = torch.where(is_below, torch.minimum(points[:, 2], level), points[:, 2])
    return _splats_at(points, normals, spacing, rim, partial, cover)


def _splats_at(
    points: Tensor,  # [N, 3]
    normals: Tensor,  # [N, 3]
    spacing: float,
    rim: _Rim,
    partial: Splats,
    cover: Cover,
) -> Splats:
    """Return flat splats in the colours of the rim, within P's box."""
    colors = rim.mean(partial.base_colors.clamp(0.0, 1.0)[cover.owners])
    low, high = partial.bounds()
    points = torch.minimum(torch.maximum(points, low), high)
    scales = torch.full((len(points), 3), _OVERLAP * spacing)
    scales[:, 2] *= _FLATNESS
    opacities = torch.full((len(points),), _OPACITY)
    return Splats(points, quaternions_facing(normals), scales, opacities, colors_to_sh(colors))


def _spread(points: Tensor, spacing: float, most: int) -> tuple[Tensor, float]:  # [N, 3], [M]
    """Keep one central point per cube of a grid, coarse enough for ``most``; return the side."""
    while True:
        place = (points + 1.0) / spacing
        cells = torch.floor(place)
        order = (place - cells - 0.5).square().sum(dim=1).argsort(stable=True)
        x, y, z = cells[order].long().unbind(1)
        _, first = np.unique(((x * 4096 + y) * 4096 + z).numpy(), return_index=True)
        if len(first) <= most:
            kept = order[torch.from_numpy(np.sort(first))]
            return kept, spacing
        spacing *= 1.1


@dataclass(frozen=True, slots=True)
class _Rim:
    """For every new point the nearest points of P's cover, weighted by nearness."""

    index: Tensor  # [N, K]
    weight: Tensor  # [N, K] of sum 1

    def mean(self, values: Tensor) -> Tensor:  # [M, C] -> [N, C]
        """Return weighted means of values that the cover's points have."""
        return (self.weight[:, :, None] * values[self.index]).sum(dim=1)


def _rim_of(points: Tensor, normals: Tensor, cover: Cover) -> _Rim:  # [N, 3], [N, 3]
    """Return the cover's points about new ones; those that face the same way count most by far."""
    number = min(_RIM_NEIGHBOURS, len(cover.points))
    distance, index = cover.tree.query(points.numpy(), k=number)
    near = torch.from_numpy(np.asarray(index).reshape(len(points), -1))
    away = torch.from_numpy(np.asarray(distance).reshape(len(points), -1)).float()
    agrees = (cover.normals[near] * normals[:, None]).sum(dim=2) > 0
    weight = torch.where(agrees, 1.0, 1e-3) / (away + 0.2 * CELL_SIDE).square()
    return _Rim(near, weight / weight.sum(dim=1, keepdim=True))
