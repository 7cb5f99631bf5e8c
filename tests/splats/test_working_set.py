"""Which splats of P take part."""

import dataclasses

import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.splats.working_set import working_set
from tests.builders.objects import ball


def test_thinning_keeps_the_covered_area_and_counts_what_it_leaves_out():
    splats = ball(1000)
    chosen = working_set(splats, 250, "p.ply")
    assert (len(chosen.splats), chosen.thinned, chosen.total) == (250, 750, 1000)
    area = (splats.scales[:, 0] * splats.scales[:, 1]).sum()
    covered = (chosen.splats.scales[:, 0] * chosen.splats.scales[:, 1]).sum()
    assert covered == pytest.approx(float(area), rel=0.01)
    assert working_set(splats, 2000, "p.ply").splats is splats


def test_unusable_rows_are_left_out_with_a_reason():
    splats = ball(10)
    means = splats.means.clone()
    means[3] = torch.nan
    chosen = working_set(dataclasses.replace(splats, means=means), None, "p.ply")
    assert len(chosen.splats) == 9
    assert chosen.unusable == {"non_finite_mean": 1}
    nothing = dataclasses.replace(splats, means=means * torch.nan)
    with pytest.raises(UserError, match=r"p\.ply: expected at least one splat"):
        working_set(nothing, None, "p.ply")
