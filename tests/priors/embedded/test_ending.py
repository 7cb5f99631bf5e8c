"""How P ends decides whether it is complete, mirrored, or guessed."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gscomplete.framing.cut_plane import CutPlane, find_cut
from gscomplete.framing.extent import Exposure
from gscomplete.priors.embedded.ending import ending_of, features_of_ending, mirror_of_half
from gscomplete.shape.benefit import OF_ENDING
from gscomplete.shape.mirror_plane import HalfCut, MirrorPlane
from gscomplete.splats import Splats
from gscomplete.splats.geometry.neighbourhood import flat_axes
from tests.builders.objects import angle_between, ball, moved

BALL = ball()
HALF = BALL.select(BALL.means[:, 0] < 0)
POINTS = HALF.means.double().numpy()
CUT = find_cut(POINTS, flat_axes(HALF))


def test_a_closed_surface_lacks_nothing() -> None:
    ending = ending_of(BALL, "guess")
    assert ending.is_complete
    assert "complete" in ending.notes[0]


def test_a_square_cut_is_mirrored_and_that_is_all() -> None:
    ending = ending_of(HALF, "guess")
    assert ending.image_is_all
    assert ending.in_plane
    assert isinstance(ending.mirror, MirrorPlane)
    assert angle_between(ending.mirror.azimuth_deg, 0.0) <= 3.0


def test_users_are_told_of_a_cut_that_is_none_of_symmetry() -> None:
    ending = ending_of(BALL.select(BALL.means[:, 0] < 0.12), "guess")
    assert ending.mirror == "guess"
    (note,) = ending.notes
    azimuth_deg, offset = map(float, note.split("upright plane ")[1].split(";")[0].split(","))
    assert angle_between(azimuth_deg, 0.0) <= 3.0
    assert offset == pytest.approx(0.12, abs=0.02)  # a spacing
    assert "--mirror cut" in note


@pytest.mark.parametrize("wish", ["none", MirrorPlane(30.0, 0.1)])
@pytest.mark.parametrize("partial", [BALL, HALF])
def test_what_users_say_counts(wish: MirrorPlane, partial: Splats) -> None:
    ending = ending_of(partial, wish)
    assert ending.mirror == wish
    assert not ending.image_is_all
    assert not ending.is_complete


@pytest.mark.parametrize("toward_deg", [None, 10.0])
def test_one_half_is_mirrored_through_its_end(toward_deg: float | None) -> None:
    plane = mirror_of_half(HALF, CUT, HalfCut(toward_deg))
    assert plane is not None
    assert angle_between(plane.azimuth_deg, 0.0) <= 3.0
    assert abs(plane.offset) < 0.02


def test_an_end_far_from_the_frame_is_none() -> None:
    away = moved(HALF, (2.0, 0.0, 0.0))
    assert mirror_of_half(away, find_cut(away.means.double().numpy()), HalfCut()) is None
    assert mirror_of_half(HALF.select(torch.arange(50)), None, HalfCut()) is None


def test_what_may_lack_something_is_told_by_numbers_and_what_users_decide_is_not() -> None:
    tilted = BALL.select(BALL.means[:, 2] < 0.15)  # open above: neither closed nor cut upright
    features = ending_of(tilted, "guess").features
    assert features is not None
    assert features.shape == (len(OF_ENDING),)
    assert np.isfinite(features).all()
    for partial, wish in ((BALL, "guess"), (HALF, "guess"), (tilted, "none")):
        assert ending_of(partial, wish).features is None


def test_numbers_of_the_ending_are_logs_and_those_of_the_cut() -> None:
    exposure = Exposure(POINTS)
    without = dict(zip(OF_ENDING, features_of_ending(POINTS, None, exposure), strict=True))
    assert without["log_exposed"] == pytest.approx(np.log(exposure.with_few + 1e-3))
    assert without["log_exposed_finely"] == pytest.approx(np.log(exposure.with_many + 1e-3))
    assert without["thickness"] == pytest.approx(0.5, abs=1e-3)  # 1e-4 by the points' spacing
    assert without["is_cut"] == without["squareness"] == without["cut_offset"] == 0
    cut = CutPlane(10.0, -0.2, 0.9, 0.6, 0.3)
    found = dict(zip(OF_ENDING, features_of_ending(POINTS, cut, exposure), strict=True))
    assert found["is_cut"] == found["meets_surface"] == 1
    assert found["squareness"] == pytest.approx(0.6)
    assert found["cut_offset"] == pytest.approx(-0.2)
