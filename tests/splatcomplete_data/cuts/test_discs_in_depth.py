"""A scanner sees slanted surfaces whole, and nothing behind them."""

from __future__ import annotations

import numpy as np
import torch

from splatcomplete_data.cuts.named import SCAN_DISTANCE, ScanCut
from tests.splatcomplete_data.balls import ball


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
