"""Which splats of P take part."""

import dataclasses

import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.splats import concatenate
from gscomplete.splats.working_set import without_far, without_strays, working_set
from gscomplete.views import ObjectFrame
from tests.builders.objects import ball


def test_thinning_keeps_the_covered_area_and_counts_what_it_leaves_out():
    splats = ball(1000)
    chosen = working_set(splats, 250, "p.ply")
    assert (len(chosen.splats), chosen.thinned, chosen.total) == (250, 750, 1000)
    area = (splats.scales[:, 0] * splats.scales[:, 1]).sum()
    covered = (chosen.splats.scales[:, 0] * chosen.splats.scales[:, 1]).sum()
    assert covered == pytest.approx(float(area), rel=1e-6)  # float32
    assert working_set(splats, 2000, "p.ply").splats is splats


def test_unusable_rows_are_left_out_with_a_reason():
    splats = ball(10)
    means = splats.means.clone()
    means[3] = torch.nan
    chosen = working_set(dataclasses.replace(splats, means=means), None, "p.ply")
    assert len(chosen.splats) == 9
    assert chosen.unusable == {"non_finite_mean": 1}
    assert chosen.summary == "9 of 10 splats of P are used; 1 left out (non finite mean)"
    nothing = dataclasses.replace(splats, means=means * torch.nan)
    with pytest.raises(UserError, match=r"p\.ply: .* found none of 10 \(10 non finite mean\)"):
        working_set(nothing, None, "p.ply")


@pytest.mark.parametrize(("strays", "left_out"), [(0, 0), (15, 15), (60, 0)])
def test_a_few_splats_far_outside_the_object_are_left_out(strays, left_out):
    splats, frame = ball(1000), ObjectFrame("Z", (0.0, 0.0, 0.0), 0.8)
    away = splats.select(torch.arange(strays))
    away = dataclasses.replace(away, means=away.means + torch.tensor([1e6, 0.0, 0.0]))
    chosen = without_far(
        working_set(concatenate([away, splats]), None, "p.ply"), frame.object_from_file
    )
    assert len(chosen.splats) == 1000 + strays - left_out
    assert chosen.unusable == ({"far_outside_the_object": left_out} if left_out else {})
    assert ("15 left out (far outside the object)" in chosen.summary) == bool(left_out)
    assert chosen.total == 1000 + strays


@pytest.mark.parametrize(("strays", "left_out"), [(0, 0), (30, 30), (600, 0)])
def test_strays_are_left_out_unless_they_are_most_of_the_set(strays, left_out):
    working = working_set(ball(1000), None, "p.ply")
    chosen = without_strays(working, torch.arange(1000) < strays)
    assert len(chosen.splats) == 1000 - left_out
    expected = {"strays_beside_the_surface": left_out} if left_out else {}
    assert chosen.unusable == expected
    if left_out:
        assert torch.equal(chosen.splats.means, working.splats.means[strays:])
        assert "30 left out (strays beside the surface)" in chosen.summary
