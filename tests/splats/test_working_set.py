"""Which splats of P take part."""

import dataclasses

import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.splats import concatenate
from gscomplete.splats import working_set as working_sets
from gscomplete.splats.working_set import without_far, working_set
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


Z_UP = torch.eye(3, dtype=torch.float64)


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


@pytest.mark.parametrize("strays", [0, 30])
def test_strays_are_drawn_but_not_heeded(strays, monkeypatch):
    monkeypatch.setattr(working_sets, "stray_rows", lambda splats: torch.arange(2000) < strays)
    splats = ball(2000)
    chosen = working_set(splats, None, "p.ply", Z_UP)
    assert torch.equal(chosen.splats.means, splats.means)
    assert torch.equal(chosen.heeded.means, splats.means[strays:])
    assert ("nothing is guessed from 30 strays beside the surface" in chosen.summary) == (
        strays == 30
    )
    assert torch.equal(working_set(splats, None, "p.ply").heeded.means, splats.means)
    near = without_far(chosen, ObjectFrame("Z", (0.0, 0.0, 0.0), 0.8).object_from_file)
    assert near is chosen


def test_what_is_far_outside_is_neither_drawn_nor_heeded(monkeypatch):
    monkeypatch.setattr(working_sets, "stray_rows", lambda splats: torch.arange(1000) < 20)
    splats = ball(1000)
    means = splats.means.clone()
    means[10:25] += torch.tensor([1e6, 0.0, 0.0])
    given = dataclasses.replace(splats, means=means)
    chosen = without_far(
        working_set(given, None, "p.ply", Z_UP),
        ObjectFrame("Z", (0.0, 0.0, 0.0), 0.8).object_from_file,
    )
    assert torch.equal(chosen.splats.means, torch.cat([means[:10], means[25:]]))
    assert torch.equal(chosen.heeded.means, means[25:])
