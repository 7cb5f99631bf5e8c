"""Colours pass into P's at the seam, and nowhere else."""

import dataclasses
import math

import pytest
import torch

from gscomplete.completion.seam import match_seam_colors
from gscomplete.splats import Splats, colors_to_sh, concatenate
from gscomplete.splats.oklab import oklab_from_srgb
from tests.builders.objects import round_splats


def strip(start: float, stop: float, color: torch.Tensor) -> Splats:
    """A strip of splats along x, with colours [N, 3] or one for all."""
    x, y = torch.meshgrid(
        torch.arange(start, stop, 0.01), torch.arange(0.0, 0.1, 0.01), indexing="ij"
    )
    means = torch.stack([x.flatten(), y.flatten(), torch.zeros(x.numel())], dim=1)
    return round_splats(means, scale=0.01, color=color)


PARTIAL = strip(-0.5, 0.0, torch.tensor([0.8, 0.3, 0.2]))
NEW = strip(0.0, 0.8, torch.tensor([0.5, 0.4, 0.5]))


def test_the_difference_goes_at_the_seam_and_fades_away_from_it():
    matched, report = match_seam_colors(NEW, PARTIAL)
    off = (matched.base_colors - torch.tensor([0.8, 0.3, 0.2])).norm(dim=1)
    near, middle, far = (NEW.means[:, 0] < 0.02, (NEW.means[:, 0] - 0.15).abs() < 0.01,
                         NEW.means[:, 0] > 0.5)  # fmt: skip
    assert float(off[near].max()) < 0.05
    assert float(off[near].max()) < float(off[middle].mean()) < float(off[far].mean())
    assert torch.equal(matched.sh[far], NEW.sh[far])
    assert report.difference_after < 0.2 * report.difference_before
    assert report.changed == int((matched.sh != NEW.sh).flatten(1).any(1).sum())


def test_only_base_colours_change():
    new = dataclasses.replace(NEW, sh=torch.cat([NEW.sh, torch.ones(len(NEW), 3, 3)], dim=1))
    matched, _ = match_seam_colors(new, PARTIAL)
    assert torch.equal(matched.sh[:, 1:], new.sh[:, 1:])
    for name, value in matched.fields():
        if name != "sh":
            assert torch.equal(value, getattr(new, name))


def test_a_pattern_stays():
    # Stripes narrower than the neighbourhood keep their contrast while their mean moves.
    stripes = torch.where((torch.arange(len(NEW)) % 2 == 0)[:, None], 0.4, 0.6).expand(-1, 3)
    matched, _ = match_seam_colors(dataclasses.replace(NEW, sh=colors_to_sh(stripes)), PARTIAL)
    near = matched.base_colors[NEW.means[:, 0] < 0.02]
    contrast = oklab_from_srgb(near[1::2]) - oklab_from_srgb(near[::2])
    before = oklab_from_srgb(torch.full((1, 3), 0.6)) - oklab_from_srgb(torch.full((1, 3), 0.4))
    # the shift of a splat differs from its neighbour's by under a hundredth of their contrast
    assert torch.allclose(contrast[:, 0].mean(), before[0, 0], rtol=0.01, atol=0.0)


def test_equal_colours_stay_equal():
    same = strip(0.0, 0.3, torch.tensor([0.8, 0.3, 0.2]))
    matched, report = match_seam_colors(same, PARTIAL)
    assert torch.allclose(matched.sh, same.sh, atol=1e-5)
    assert report.difference_before < 1e-6


@pytest.mark.parametrize("shift", [5.0, None])
def test_without_a_seam_nothing_changes(shift):
    new = NEW.select(torch.zeros(0, dtype=torch.long))
    if shift is not None:
        new = dataclasses.replace(NEW, means=NEW.means + shift)
    matched, report = match_seam_colors(new, PARTIAL)
    assert torch.equal(matched.sh, new.sh)
    assert report.changed == report.seam_splats == 0


def test_faint_splats_have_no_say():
    green = torch.tensor([0.1, 0.9, 0.1])
    expected, _ = match_seam_colors(NEW, PARTIAL)
    dust = strip(-0.05, 0.05, green)
    dust = dataclasses.replace(dust, opacities=torch.full((len(dust),), 0.09))
    matched, _ = match_seam_colors(NEW, concatenate([PARTIAL, dust]))
    assert torch.equal(matched.sh, expected.sh)
    matched, report = match_seam_colors(concatenate([NEW, dust]), PARTIAL)
    assert torch.equal(matched.sh[: len(NEW)], expected.sh)
    assert report.seam_splats < len(NEW)


def test_the_shift_is_the_weighted_mean_of_the_differences_at_the_seam(monkeypatch):
    """Two pairs at the seam, 0.04 apart, and one new splat 0.03 and 0.05 from them."""
    places = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.04, 0.0]])
    colors = torch.tensor([[0.8, 0.3, 0.2], [0.3, 0.4, 0.7]])
    partial = dataclasses.replace(
        PARTIAL.select(torch.arange(2)), means=places, sh=colors_to_sh(colors)
    )
    own = torch.tensor([[0.5, 0.4, 0.5], [0.5, 0.5, 0.4], [0.6, 0.5, 0.5]])
    new = dataclasses.replace(
        NEW.select(torch.arange(3)),
        means=torch.cat([places, torch.tensor([[0.03, 0.0, 0.0]])]),
        sh=colors_to_sh(own),
    )
    for name, value in {"REACH": 0.01, "SMOOTHNESS": 0.04, "FADE": 0.05, "NEIGHBOURS": 1}.items():
        monkeypatch.setattr(f"gscomplete.completion.seam._{name}", value)
    matched, report = match_seam_colors(new, partial)
    assert report.seam_splats == 2
    gap = oklab_from_srgb(colors) - oklab_from_srgb(own[:2])
    squared = torch.tensor([0.03**2, 0.05**2], dtype=torch.float64)
    weight = torch.exp(-0.5 * squared / 0.04**2)
    shift = math.exp(-0.5 * (0.03 / 0.05) ** 2) * (weight[:, None] * gap).sum(0) / weight.sum()
    found = oklab_from_srgb(matched.base_colors[2:]) - oklab_from_srgb(own[2:])
    assert found[0].tolist() == pytest.approx(shift.tolist(), abs=1e-5)
