"""A scanner sees slanted surfaces without slits, and nothing behind them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from gscomplete.splats.rotations import rotation_matrices
from splatcomplete_data.cuts.geometry import looking_rotation
from splatcomplete_data.cuts.named import SCAN_DISTANCE, ScanCut
from splatcomplete_data.cuts.transmittance import seen_splats
from tests.builders.objects import ball, random_splats


def test_what_is_seen_of_a_ball_is_what_rays_reach() -> None:
    """A point of a ball is seen where its normal faces the scanner: no slits towards the rim."""
    whole = ball(12_000, 0.5)
    eye = SCAN_DISTANCE * np.array([np.cos(0.3), 0.0, np.sin(0.3)])
    seen = ScanCut(((0.0, float(np.degrees(0.3))),)).apply(whole).mask.numpy()
    points = whole.means.double().numpy()
    toward = eye - points
    facing = (2 * points * toward).sum(axis=1) / np.linalg.norm(toward, axis=1)
    assert seen[facing > 0.1].mean() > 0.99
    assert seen[facing < -0.2].mean() < 0.01


def test_a_table_seen_at_a_slant_has_no_slits() -> None:
    """From 10 degrees above; before, every depth pixel kept only its nearest row of splats."""
    side = np.linspace(-0.5, 0.5, 90)
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    flat = ball(len(grid), 0.5)
    means = torch.from_numpy(np.concatenate([grid, np.zeros((len(grid), 1))], axis=1)).float()
    scales = torch.tensor([0.008, 0.008, 0.0008]).repeat(len(grid), 1)
    turn = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(len(grid), 1)
    table = type(flat)(means, turn, scales, flat.opacities, flat.sh)
    assert ScanCut(((30.0, 10.0),)).apply(table).mask.all()


@pytest.mark.parametrize(
    ("eye", "giants", "grid"),
    [((0.0, -2.5, 0.4), 1.0, 64), ((0.0, -2.5, 0.4), 30.0, 600), ((0.0, -0.7, 0.1), 30.0, 600)],
    ids=["small discs", "some that fill the image", "and some about the scanner"],
)
def test_seen_is_what_a_slow_computation_says(eye, giants, grid) -> None:
    """Disc by disc in float64, as the module's head defines it; those near the limit are left."""
    splats = random_splats(300, seed=3)
    flat = splats.scales * torch.tensor([2.0, 1.5, 0.05])
    flat[::60] *= giants
    faint = splats.opacities.clone()
    faint[::60] *= 0.5
    splats = dataclasses.replace(splats, scales=flat, opacities=faint)
    eye = np.array(eye)
    turn = looking_rotation(eye, np.zeros(3))
    found = seen_splats(splats, eye, turn, grid, 3.0)
    local = (splats.means.double().numpy() - eye) @ turn.T
    axes = rotation_matrices(splats.quaternions.double()).numpy()
    axes = np.einsum("ij,njk->nik", turn, axes)
    sigmas = splats.scales.double().numpy()
    order = np.argsort(-sigmas, axis=1)
    typical = np.median(sigmas.max(axis=1))
    light = np.ones(len(local))
    for m, target in enumerate(local):
        distance = np.linalg.norm(target)
        own = abs(axes[m][:, order[m, 2]] @ target) / distance
        slack = max(0.003, 0.5 * typical) / max(own, 0.15)
        for n, middle in enumerate(local):
            normal = axes[n][:, order[n, 2]]
            share = (normal @ middle) / (normal @ target)
            if n == m or not 0 < share < 1 - slack / distance:
                continue
            offset = share * target - middle
            along = [offset @ axes[n][:, k] / sigmas[n, k] for k in order[n, :2]]
            away = along[0] ** 2 + along[1] ** 2
            if away < 9:
                light[m] *= 1 - min(float(splats.opacities[n]) * np.exp(-0.5 * away), 0.999)
    is_clear = np.abs(light - 0.55) > 1e-4
    is_before = (local[:, 2] > 1e-4) & (np.abs(local[:, :2]) <= 3 * local[:, 2:]).all(axis=1)
    assert is_clear.sum() > 250
    assert np.array_equal(found[is_clear], ((light > 0.55) & is_before)[is_clear])
    assert 20 < found.sum() < 280


def test_a_sheet_that_lets_half_of_the_light_through_hides_nothing() -> None:
    """And two of them do."""
    side = np.linspace(-0.3, 0.3, 40)
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    behind = np.array([[-0.2, 0.0, 0.0]])
    for xs, is_seen in (((0.2,), True), ((0.2, 0.1), False)):
        sheets = [np.concatenate([np.full((len(grid), 1), x), grid], axis=1) for x in xs]
        means = torch.from_numpy(np.concatenate([behind, *sheets])).float()
        base = ball(len(means), 0.5)
        # a sheet of spacing s, sigma s / 2: 0.08 each add up to a transmittance near 0.6
        scales = torch.tensor([0.0008, 0.0077, 0.0077]).repeat(len(means), 1)
        turn = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(len(means), 1)
        faint = torch.full((len(means),), 0.25)
        splats = type(base)(means, turn, scales, faint, base.sh)
        assert bool(ScanCut(((0.0, 0.0),)).apply(splats).mask[0]) == is_seen
