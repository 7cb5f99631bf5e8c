import torch

from gscomplete.splats.record import Splats, colors_to_sh
from splatcomplete_data import flaws
from splatcomplete_data.cuts.random_cuts import random_partial
from splatcomplete_data.flaws import corrupt
from tests.builders.objects import BALL


def test_flaws_stay_small_and_repeatable():
    mask = random_partial(BALL, 1, 1).mask
    clean, touched = 0, 0
    for index in range(40):
        flawed = corrupt(BALL, mask, 2, index)
        again = corrupt(BALL, mask, 2, index)
        for (name, a), (_, b) in zip(flawed.fields(), again.fields(), strict=True):
            assert torch.equal(a, b), name
            assert torch.isfinite(a).all(), name
        assert 0.45 * int(mask.sum()) <= len(flawed) <= 1.01 * int(mask.sum()) + 1
        same = len(flawed) == int(mask.sum()) and torch.equal(flawed.means, BALL.means[mask])
        clean, touched = clean + same, touched + (not same)
    assert clean >= 5
    assert touched >= 15


def test_of_nothing_kept_nothing_is_made():
    assert len(corrupt(BALL, torch.zeros(len(BALL), dtype=torch.bool), 0, 0)) == 0


def test_higher_bands_of_color_are_left_alone(monkeypatch):
    sh = torch.cat([colors_to_sh(torch.rand(len(BALL), 3)), torch.rand(len(BALL), 3, 3)], dim=1)
    splats = Splats(BALL.means, BALL.quaternions, BALL.scales, BALL.opacities, sh)
    mask = torch.ones(len(BALL), dtype=torch.bool)
    for name in ("CLEAN_SHARE", "MOST_HOLES", "FLYING_SHARE"):
        monkeypatch.setattr(flaws, f"_{name}", 0)
    assert torch.equal(corrupt(splats, mask, 0, 3).sh[:, 1:], sh[:, 1:])
