"""Splats on a page are those of the completion, to the packing's precision."""

import dataclasses

import numpy as np
import torch

from gscomplete.report.packed_splats import packed, unpacked
from gscomplete.splats import Splats, colors_to_sh, concatenate


def cloud(count: int, seed: int) -> Splats:
    g = torch.Generator().manual_seed(seed)
    quaternions = torch.nn.functional.normalize(torch.randn(count, 4, generator=g), dim=1)
    scales = 10 ** (-1 - 2.5 * torch.rand(count, 3, generator=g))
    colors = colors_to_sh(torch.rand(count, 3, generator=g))
    opacities = 0.05 + 0.9 * torch.rand(count, generator=g)
    return Splats(torch.rand(count, 3, generator=g) - 0.5, quaternions, scales, opacities, colors)


def test_fields_come_back():
    splats = cloud(65, 0)
    found = unpacked(packed(splats, 1000))
    assert len(found["means"]) == 65
    assert np.abs(found["means"] - splats.means.numpy()).max() < 2e-5  # 2 / 65535 / 2
    assert np.abs(found["scales"] / splats.scales.numpy() - 1).max() < 0.02  # 1 / 255 of 8.5
    assert np.abs(found["quaternions"] - splats.quaternions.numpy()).max() < 0.5 / 127 + 1e-6
    assert np.abs(found["colors"] - splats.base_colors.numpy()).max() < 0.5 / 255 + 1e-6
    assert np.abs(found["opacities"] - splats.opacities.numpy()).max() < 0.5 / 255 + 1e-6


def test_many_are_thinned_and_widened():
    splats = cloud(6000, 0)
    found = unpacked(packed(splats, 600))
    assert len(found["means"]) == 600
    before = float(splats.scales.log().mean())
    assert abs(float(np.log(found["scales"]).mean()) - before - 0.5 * np.log(10)) < 0.1


def test_what_is_thinned_leaves_no_holes():
    """Of a sheet twenty times as dense on one side, both sides are covered alike."""
    g = torch.Generator().manual_seed(0)
    places = torch.rand(21_000, 2, generator=g) * torch.tensor([1.0, 0.5])
    places[1000:, 1] -= 0.5
    means = torch.cat([places, torch.zeros(21_000, 1)], dim=1) * 0.9
    rest = cloud(21_000, 1)
    sheet = dataclasses.replace(rest, means=means)
    found = unpacked(packed(sheet, 1000))["means"]
    sparse, dense = found[found[:, 1] > 0.01], found[found[:, 1] < -0.01]
    assert 0.5 < len(sparse) / len(dense) < 1.2
    assert packed(dataclasses.replace(rest, means=torch.zeros(21_000, 3)), 500)["count"] == 500


def test_as_many_are_taken_as_asked_for():
    """More than an alignment looks at."""
    splats = cloud(80_000, 0)
    assert packed(splats, 50_000)["count"] > 45_000
    assert packed(splats, 80_000)["count"] == 80_000


def test_faint_and_far_splats_stay_away_and_none_at_all_is_fine():
    splats = cloud(30, 0)
    far = Splats(splats.means + 5, splats.quaternions, splats.scales, splats.opacities, splats.sh)
    faint = dataclasses.replace(splats, opacities=torch.full((30,), 0.01))
    assert len(unpacked(packed(concatenate([splats, far, faint]), 100))["means"]) == 30
    assert packed(far, 100) == {"count": 0, "data": ""}
