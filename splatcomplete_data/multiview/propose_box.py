"""Propose a box around what the cameras look at.

Conventions
-----------
* Splats count by the area they cover times their opacity, so that a smooth wall of few large
  splats weighs as much as a detailed one of many small ones.
* Three steps: look within a ball about what the cameras look at; take away planes that the object
  stands on or hangs at (table, bed, wall), found by RANSAC; take the heaviest cluster about the
  ball's centre. The box stands on the plane, turned to fit, and holds nearly all of the cluster.
* It is a proposal: ``crop`` draws it, and people correct it.
* Random numbers come from the seed alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gscomplete.errors import UserError
from gscomplete.splats import Splats, usable_rows
from splatcomplete_data.boxes import CropBox

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ProposalSettings:
    """Knobs of the proposal; lengths in radii of the ball looked at."""

    min_opacity: float = 0.2
    """Fainter splats do not count."""
    most_planes: int = 2
    """Planes taken away at most: a table and a wall."""
    plane_samples: int = 600
    """RANSAC's tries for every plane."""
    plane_slack: float = 0.025
    """Half thickness of a plane."""
    plane_share: float = 0.12
    """Least share of the weight that a plane holds."""
    one_side_share: float = 0.9
    """Least share of the other weight that lies on one side of a plane that bears the object."""
    cells: int = 40
    """Cells of the clustering grid along the ball's diameter."""
    cell_share: float = 0.02
    """Cells lighter than this share of the 99th percentile of cells are empty."""
    quantile: float = 0.004
    """Share of the cluster left out at either end of every axis."""
    margin: float = 0.03
    """Added to the half extents."""
    seed: int = 0
    """Of RANSAC."""


@dataclass(frozen=True, slots=True)
class Proposal:
    """A box, and how it was found."""

    box: CropBox
    planes: tuple[tuple[FloatArray, float], ...]  # normal towards the object, offset
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Focus:
    """Where to look: a ball in the file's frame."""

    center: FloatArray  # [3]
    radius: float
    up: FloatArray  # [3]; the box stands along it when there is no plane


def focus_of_cameras(
    positions: FloatArray,  # [V, 3]
    look_at: FloatArray,  # [3]
    up: FloatArray,  # [3]
    half_fov_tangent: float,
) -> Focus:
    """Return the ball that a photo of the object frames at the cameras' median distance."""
    distance = float(np.median(np.linalg.norm(positions - look_at, axis=1)))
    return Focus(look_at, max(0.9 * distance * half_fov_tangent, 1e-9), up)


def focus_of_splats(splats: Splats, up: FloatArray) -> Focus:
    """Return the ball about the densest place, when no cameras are known."""
    points, weight = _solid(splats, 0.2)
    center = _weighted_median(points, weight)
    for _ in range(10):  # mean shift: the ball holds half of the weight at first, then less
        distance = np.linalg.norm(points - center, axis=1)
        near = distance <= np.quantile(distance, 0.5)
        center = np.average(points[near], axis=0, weights=weight[near])
    distance = np.linalg.norm(points - center, axis=1)
    return Focus(center, max(float(np.quantile(distance, 0.6)), 1e-9), up)


def propose_box(splats: Splats, focus: Focus, settings: ProposalSettings | None = None) -> Proposal:
    """Propose a box around the central cluster.

    Raises:
        UserError: there is nothing to be seen where the cameras look.
    """
    settings = settings or ProposalSettings()
    points, weight = _solid(splats, settings.min_opacity)
    local = (points - focus.center) / focus.radius
    near = np.linalg.norm(local, axis=1) <= 1.4
    if near.sum() < 20:
        raise UserError(
            "--box auto: expected splats where the cameras look, found none within "
            f"{focus.radius:.4g} of {focus.center.round(4).tolist()}; give the box as numbers"
        )
    local, weight = local[near], weight[near]
    planes = _supporting_planes(local, weight, settings)
    free = np.linalg.norm(local, axis=1) <= 1.0
    for normal, offset in planes:
        free &= local @ normal - offset > settings.plane_slack
    notes = [
        f"plane {index + 1} (normal {(normal.round(2) + 0.0).tolist()}) taken away"
        for index, (normal, _) in enumerate(planes)
    ]
    if free.sum() < 20:
        raise UserError("--box auto: found nothing beside a plane; give the box as numbers")
    cluster = _central_cluster(local[free], weight[free], settings)
    members = local[free][cluster]
    notes.append(f"central cluster of {len(members):,} of {len(splats):,} splats")
    axis = planes[0][0] if planes else focus.up / np.linalg.norm(focus.up)
    box = _fit(members, axis, planes, settings)
    center = focus.center + focus.radius * np.array(box.center)
    half = focus.radius * np.array(box.half_extents)
    in_file = CropBox(_three(center), _three(half), box.quaternion)
    unscaled = tuple((n, float(n @ focus.center + focus.radius * o)) for n, o in planes)
    return Proposal(in_file, unscaled, tuple(notes))


def _three(values: FloatArray) -> tuple[float, float, float]:
    """Return three rounded numbers, so that text and JSON give the same box."""
    x, y, z = (float(f"{value:.6g}") for value in values)
    return x, y, z


def _solid(splats: Splats, min_opacity: float) -> tuple[FloatArray, FloatArray]:
    """Return points [N, 3] and weights [N] of the splats that count."""
    usable, _ = usable_rows(splats)
    chosen = splats.select(usable & (splats.opacities >= min_opacity))
    if len(chosen) < 20:
        raise UserError(f"--box auto: expected splats to enclose, found {len(chosen)} solid ones")
    sizes = np.sort(chosen.scales.double().numpy(), axis=1)
    area = sizes[:, 1] * sizes[:, 2]
    area = np.clip(area, None, np.quantile(area, 0.95))
    return chosen.means.double().numpy(), chosen.opacities.double().numpy() * area


def _weighted_median(points: FloatArray, weight: FloatArray) -> FloatArray:  # [3]
    """Return the median along every axis."""
    result = np.empty(3)
    for axis in range(3):
        order = np.argsort(points[:, axis])
        total = np.cumsum(weight[order])
        result[axis] = points[order[np.searchsorted(total, 0.5 * total[-1])], axis]
    return result


def _supporting_planes(
    local: FloatArray, weight: FloatArray, settings: ProposalSettings
) -> list[tuple[FloatArray, float]]:
    """Find planes that bear the object: heavy, and with the rest on one side."""
    planes: list[tuple[FloatArray, float]] = []
    rng = np.random.default_rng(settings.seed)
    free = np.ones(len(local), np.bool_)
    total = float(weight.sum())
    for _ in range(settings.most_planes):
        points, mass = local[free], weight[free]
        if len(points) < 20:
            break
        normal, offset, held = _heaviest_plane(points, mass, settings, rng)
        distance = points @ normal - offset
        above = float(mass[distance > settings.plane_slack].sum())
        below = float(mass[distance < -settings.plane_slack].sum())
        if below > above:
            normal, offset, above, below = -normal, -offset, below, above
        if held < settings.plane_share * total:
            break
        if above < settings.one_side_share * (above + below) or above <= 0:
            break
        planes.append((normal, offset))
        free &= local @ normal - offset > settings.plane_slack
    return planes


def _heaviest_plane(
    points: FloatArray, weight: FloatArray, settings: ProposalSettings, rng: np.random.Generator
) -> tuple[FloatArray, float, float]:
    """Return normal, offset and weight of the plane that holds most."""
    chance = weight / weight.sum()
    picks = points[rng.choice(len(points), (settings.plane_samples, 3), p=chance)]
    normals = np.cross(picks[:, 1] - picks[:, 0], picks[:, 2] - picks[:, 0])
    length = np.linalg.norm(normals, axis=1)
    normals = normals[length > 1e-3] / length[length > 1e-3, None]
    offsets = (normals * picks[length > 1e-3, 0]).sum(axis=1)
    sample = rng.choice(len(points), min(len(points), 4000), p=chance)
    close = np.abs(points[sample] @ normals.T - offsets) <= settings.plane_slack
    best = int(close.sum(axis=0).argmax())
    normal, offset = normals[best], float(offsets[best])
    for _ in range(3):  # refine by least squares over what the plane holds
        held = np.abs(points @ normal - offset) <= settings.plane_slack
        middle = np.average(points[held], axis=0, weights=weight[held])
        spread = (points[held] - middle) * np.sqrt(weight[held])[:, None]
        refined = np.linalg.svd(spread, full_matrices=False)[2][2]
        normal, offset = refined, float(refined @ middle)
    held = np.abs(points @ normal - offset) <= settings.plane_slack
    return normal, offset, float(weight[held].sum())


def _central_cluster(
    local: FloatArray, weight: FloatArray, settings: ProposalSettings
) -> NDArray[np.bool_]:
    """Mark the connected cells that weigh most, the nearer to the centre the more."""
    cells = settings.cells
    index = np.clip(((local + 1.0) * (0.5 * cells)).astype(np.int64), 0, cells - 1)
    grid = np.zeros((cells, cells, cells))
    np.add.at(grid, tuple(index.T), weight)
    full = grid >= settings.cell_share * np.quantile(grid[grid > 0], 0.99)
    labels, count = ndimage.label(full, structure=np.ones((3, 3, 3)))
    own = labels[tuple(index.T)]
    pull = weight * np.exp(-4.0 * np.square(local).sum(axis=1))
    score = np.bincount(own, pull, minlength=count + 1)
    score[0] = 0.0
    mask: NDArray[np.bool_] = own == int(score.argmax())
    return mask


def _fit(
    members: FloatArray,
    axis: FloatArray,
    planes: list[tuple[FloatArray, float]],
    settings: ProposalSettings,
) -> CropBox:
    """Fit a box along ``axis``, turned about it to the smallest base, down to the plane."""
    helper = np.eye(3)[int(np.abs(axis).argmin())]
    first = helper - (helper @ axis) * axis
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    low_q, high_q = settings.quantile, 1.0 - settings.quantile
    best: tuple[float, FloatArray] | None = None
    for angle in np.deg2rad(np.arange(0.0, 90.0, 3.0)):
        u = np.cos(angle) * first + np.sin(angle) * second
        turn = np.stack([u, np.cross(axis, u), axis], axis=1)
        low, high = np.quantile(members @ turn, [low_q, high_q], axis=0)
        area = float(np.prod(high[:2] - low[:2]))
        if best is None or area < best[0] - 1e-9:
            best = area, turn
    assert best is not None
    turn = best[1]
    low, high = np.quantile(members @ turn, [low_q, high_q], axis=0)
    low, high = low - settings.margin, high + settings.margin
    if planes:
        low[2] = planes[0][1] + settings.plane_slack
        high[2] = max(high[2], low[2] + settings.margin)
    half = np.maximum((high - low) / 2, 1e-6)
    center = turn @ ((low + high) / 2)
    w, x, y, z = _quaternion(turn)
    return CropBox(tuple(center), tuple(half), (w, x, y, z))


def _quaternion(rotation: FloatArray) -> tuple[float, float, float, float]:
    """Return the rounded unit quaternion wxyz of a rotation matrix."""
    import torch

    from gscomplete.splats.transform import quaternion_from_rotation

    w, x, y, z = quaternion_from_rotation(torch.from_numpy(rotation.copy())).tolist()
    return round(w, 9), round(x, 9), round(y, 9), round(z, 9)
