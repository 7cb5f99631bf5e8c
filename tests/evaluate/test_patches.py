"""Patches: known answers, a second computation, and no dependence on where a pattern lies."""

import numpy as np
import pytest
import torch

from gscomplete.evaluate.patches import patch_distance


def noise(seed: int, height: int = 20) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return 0.2 + 0.4 * torch.rand(1, height, 16, 3, generator=generator).double()


EVERYWHERE = torch.ones(1, 20, 16, dtype=torch.bool)


def test_the_same_is_nothing_and_a_brighter_picture_as_far_as_it_is_brighter():
    a = noise(0)
    assert patch_distance(a, a, EVERYWHERE) == 0.0
    assert patch_distance(a, a + 0.125, EVERYWHERE) == pytest.approx(0.125, abs=1e-12)
    assert patch_distance(a, a, ~EVERYWHERE) is None


def test_a_moved_pattern_costs_less_than_a_smeared_one():
    stripes = (torch.arange(20) % 4 < 2).double()[None, :, None, None].expand(1, 20, 16, 3)
    moved, smeared = stripes.roll(2, dims=1), torch.full_like(stripes, 0.5)
    inner = EVERYWHERE.clone()
    inner[:, :4] = inner[:, -4:] = False
    near, far = (patch_distance(stripes, other, inner) for other in (moved, smeared))
    assert near is not None
    assert far is not None
    assert near < 1e-9
    assert far > 0.2


def test_what_lies_farther_than_a_patch_does_not_count():
    a, b = noise(0), noise(0)
    region = EVERYWHERE.clone()
    region[:, 8:] = False
    b[:, 11:] = 0.9
    assert patch_distance(a, b, region) == 0.0
    b[:, 10] = 0.9
    assert (patch_distance(a, b, region) or 0.0) > 0.0


def test_a_second_computation_agrees():
    """Patch by patch; distances of sorted values are those of distributions of equal counts."""
    a, b = noise(1), noise(2) ** 2
    directions = np.random.default_rng(0).normal(size=(147, 64))
    directions /= np.linalg.norm(directions, axis=0)
    sides = []
    for picture in (a, b):
        edges = np.pad(picture[0].numpy(), ((3, 3), (3, 3), (0, 0)), mode="edge")
        rows = [
            np.moveaxis(edges[r : r + 7, c : c + 7], 2, 0).ravel() @ directions
            for r in range(20)
            for c in range(16)
        ]
        sides.append(np.sort(rows, axis=0))
    apart = np.abs(sides[0] - sides[1]).mean(axis=0).sum() / np.abs(directions.sum(axis=0)).sum()
    # 320 values, compared at 512 quantiles between them
    assert patch_distance(a, b, EVERYWHERE) == pytest.approx(apart, rel=0.01)
