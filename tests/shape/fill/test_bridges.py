"""Holes of thin walls are bridged from rim to rim; mouths, slats and edges are not."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gscomplete.shape.fill.bridges import Patch, _cells, bridged
from gscomplete.shape.fill.close import close_gaps
from gscomplete.splats import Splats, colors_to_sh, concatenate
from gscomplete.splats.rotations import quaternions_facing

SPACING = 0.01


def plate(width: float = 0.6, height: float = 0.6) -> torch.Tensor:
    """A square grid in the plane x = 0."""
    ys = torch.arange(-width / 2, width / 2, SPACING) + SPACING / 2
    zs = torch.arange(-height / 2, height / 2, SPACING) + SPACING / 2
    flat = torch.cartesian_prod(ys, zs)
    return torch.cat([torch.zeros(len(flat), 1), flat], dim=1)


def tube(radius: float, low: float = -0.4, high: float = 0.4) -> tuple[torch.Tensor, torch.Tensor]:
    """Points and outward normals of a wall without thickness, open above and below."""
    angles = torch.arange(0, 2 * np.pi, SPACING / radius)
    grid = torch.cartesian_prod(angles, torch.arange(low, high, SPACING))
    out = torch.stack([grid[:, 0].cos(), grid[:, 0].sin(), torch.zeros(len(grid))], dim=1)
    points = radius * out
    points[:, 2] = grid[:, 1]
    return points, out


def discs(points: torch.Tensor, normals: torch.Tensor) -> Splats:
    """Grey discs that overlap into a surface."""
    scales = 0.8 * SPACING * torch.tensor([1.0, 1.0, 0.1]).repeat(len(points), 1)
    return Splats(
        points,
        quaternions_facing(normals.expand_as(points)),
        scales,
        torch.full((len(points),), 0.95),
        colors_to_sh(torch.full((len(points), 3), 0.5)),
    )


def bridge(points: torch.Tensor, normals: torch.Tensor | None = None) -> list[Patch]:
    if normals is None:
        normals = torch.tensor([[1.0, 0.0, 0.0]]).expand_as(points)
    return bridged(points, normals, SPACING)


@pytest.mark.parametrize("radius", [0.04, 0.08, 0.11])
def test_a_round_hole_of_a_plate_is_bridged(radius: float) -> None:
    points = plate()
    (patch,) = bridge(points[points.norm(dim=1) > radius])
    assert patch.points[:, 0].abs().max() < 1e-6
    away = patch.points.norm(dim=1)
    assert away.max() < radius + SPACING
    # all of the disc: of 400 places in it none is farther from the patch or rim than a diagonal
    disc = points[points.norm(dim=1) < radius - 2 * SPACING]
    assert torch.cdist(disc, patch.points).amin(dim=1).max() < 1.5 * SPACING
    assert patch.width == pytest.approx(2 * radius, abs=2.5 * SPACING)


@pytest.mark.parametrize("sureness", [1.0, 0.05])
def test_a_hole_of_a_tube_goes_on_round(sureness: float) -> None:
    """The lid is as round as the wall; normals that are not sure may have either sign."""
    points, normals = tube(0.2)
    hole = (points - torch.tensor([0.2, 0.0, 0.0])).norm(dim=1) < 0.08
    normals = sureness * normals[~hole]
    if sureness < 0.3:
        normals[::2] *= -1
    patches = bridge(points[~hole], normals)
    lid = torch.cat([patch.points for patch in patches])
    # flat, the lid's middle would be 0.017 too far inside
    assert (lid[:, :2].norm(dim=1) - 0.2).abs().max() < 0.005
    assert torch.cdist(points[hole], lid).amin(dim=1).max() < 2 * SPACING
    assert (lid[:, 2].abs() < 0.1).all()  # none over the mouths


def two_plates(gap: float) -> torch.Tensor:
    points = plate()
    return points[points[:, 1].abs() > gap / 2]


@pytest.mark.parametrize(
    "points",
    [
        plate(),
        two_plates(0.1),
        torch.cat([plate() - torch.tensor([0.05, 0, 0]), plate() + torch.tensor([0.05, 0, 0])]),
        plate()[(plate()[:, 1] > 0.05) | (plate()[:, 2] > 0.05)],
    ],
    ids=["plate", "two side by side", "two behind each other", "an angle"],
)
def test_edges_are_not_bridged(points: torch.Tensor) -> None:
    assert bridge(points) == []


def test_a_slit_is_bridged_from_side_to_side() -> None:
    points = plate()
    slit = (points[:, 1].abs() < 0.016) & (points[:, 2].abs() < 0.2)
    lid = torch.cat([patch.points for patch in bridge(points[~slit])])
    near = points[slit & (points[:, 2].abs() < 0.15)]  # its corners are rims of another way
    assert torch.cdist(near, lid).amin(dim=1).max() < 1.5 * SPACING


def test_no_points_and_few() -> None:
    assert bridge(torch.zeros(1, 3)) == []
    assert bridge(torch.rand(5, 3, generator=torch.Generator().manual_seed(0))) == []


def cup() -> tuple[Splats, torch.Tensor]:
    """A cup whose wall is 0.01 thick, and the middle of a hole through it."""
    parts = []
    for radius, sign, low in ((0.25, 1.0, -0.4), (0.24, -1.0, -0.39)):
        points, normals = tube(radius, low)
        floor = plate()[:, [1, 2, 0]]
        floor = floor[floor.norm(dim=1) < radius] + torch.tensor([0.0, 0.0, low])
        parts.append(discs(points, sign * normals))
        parts.append(discs(floor, torch.tensor([0.0, 0.0, -sign])))
    return concatenate(parts), torch.tensor([0.25, 0.0, 0.0])


def test_a_hole_through_a_cup_is_closed_and_its_mouth_is_not() -> None:
    whole, middle = cup()
    assert len(close_gaps(whole, torch.Generator().manual_seed(0)).splats) == 0
    gone = (whole.means - middle).norm(dim=1) < 0.09
    filled = close_gaps(whole.select(~gone), torch.Generator().manual_seed(0))
    assert torch.cdist(whole.means[gone], filled.splats.means).amin(dim=1).max() < 0.02
    assert ((filled.splats.means - middle).norm(dim=1) < 0.12).all()


def test_a_niche_stays_open() -> None:
    """A wall with a hole and a floor behind it that faces out."""
    whole, middle = cup()
    gone = ((whole.means - middle).norm(dim=1) < 0.09) & (whole.means[:, :2].norm(dim=1) > 0.245)
    floor = plate(0.26, 0.26) + torch.tensor([0.2, 0.0, 0.0])
    behind = discs(floor, torch.tensor([1.0, 0.0, 0.0]))
    open_ = concatenate([whole.select(~gone), behind])
    assert len(close_gaps(open_, torch.Generator().manual_seed(0)).splats) == 0


def test_more_cells_than_a_number_can_count_are_numbered_alike() -> None:
    """Places up to 1e9 cells apart, against the same ones up to 10 cells apart."""
    places = np.random.default_rng(0).integers(0, 10, (500, 3)).astype(float)
    units = np.random.default_rng(1).normal(size=(500, 3))
    near, counts = _cells(places, units, 1.0)
    far, same = _cells(1e8 * places, units, 1.0)
    np.testing.assert_array_equal(near, far)
    np.testing.assert_array_equal(counts, same)
