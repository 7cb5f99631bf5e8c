"""Splats on a page are those of the completion, to the packing's precision."""

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
    old, new = cloud(40, 0), cloud(25, 1)
    both = concatenate([old, new])
    count, text = packed(both, torch.arange(65) >= 40, 1000)
    found = unpacked(count, text)
    assert count == 65
    assert np.array_equal(found["is_new"], np.repeat([0.0, 1.0], [40, 25]))
    assert np.abs(found["means"] - both.means.numpy()).max() < 2e-5  # 2 / 65535 / 2
    assert np.abs(found["scales"] / both.scales.numpy() - 1).max() < 0.02  # 1 / 255 of 8.5 e-folds
    assert np.abs(found["quaternions"] - both.quaternions.numpy()).max() < 0.5 / 127 + 1e-6
    assert np.abs(found["colors"] - both.base_colors.numpy()).max() < 0.5 / 255 + 1e-6
    assert np.abs(found["opacities"] - both.opacities.numpy()).max() < 0.5 / 255 + 1e-6


def test_many_are_thinned_evenly_and_widened():
    both = concatenate([cloud(4000, 0), cloud(2000, 1)])
    count, text = packed(both, torch.arange(6000) >= 4000, 600)
    found = unpacked(count, text)
    assert count == 600
    assert found["is_new"].sum() == 200
    before = float(both.scales.log().mean())
    assert abs(float(np.log(found["scales"]).mean()) - before - 0.5 * np.log(10)) < 0.1


def test_faint_and_far_splats_stay_away_and_none_at_all_is_fine():
    splats = cloud(30, 0)
    far = Splats(splats.means + 5, splats.quaternions, splats.scales, splats.opacities, splats.sh)
    count, text = packed(concatenate([splats, far]), torch.zeros(60, dtype=torch.bool), 100)
    assert count == 30
    assert len(unpacked(count, text)["means"]) == 30
    assert packed(far, torch.zeros(30, dtype=torch.bool), 100) == (0, "")
