"""Cuts are read from text and keep what they say."""

import dataclasses

import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.splats import Splats, concatenate
from gscomplete.views import ObjectFrame
from splatcomplete_data.cuts.boxes import parse_box
from splatcomplete_data.cuts.named import BoxCut, PlaneCut, ScanCut, apply_cuts, parse_cut
from tests.builders.objects import BALL, ball, round_splats

FRAME = ObjectFrame("Y", (10.0, 0.0, 0.0), 2.0)


def shell(count: int = 3000) -> Splats:
    """A sphere of radius 1 about x = 10, in a y-up file frame."""
    return round_splats(ball(count, 1.0, (10.0, 0.0, 0.0)).means, scale=0.05, opacity=0.95)


def test_parse() -> None:
    assert parse_cut("plane:90,0.1") == PlaneCut(90.0, 0.1)
    assert parse_cut("box:-1,-1,-1,0,1,1") == BoxCut((-1, -1, -1), (0, 1, 1))
    assert parse_cut("scan:30/20,60/-5") == ScanCut(((30.0, 20.0), (60.0, -5.0)))
    for text in ("", "plane:", "plane:1,2,3", "box:0,0,0,0,1,1", "scan:30", "scan:3/99", "x:1"):
        with pytest.raises(UserError, match="--cut"):
            parse_cut(text)


def test_cuts_act_in_the_object_frame() -> None:
    complete = shell()
    part, steps = apply_cuts(complete, FRAME, [PlaneCut(0.0)], (), "shell")
    assert float(part.means[:, 0].max()) <= 10.0 + 1e-4
    assert steps[0].before - steps[0].after == len(complete) - len(part)
    part, _ = apply_cuts(complete, FRAME, [PlaneCut(90.0)], (), "shell")
    assert float(part.means[:, 2].min()) >= -1e-4  # azimuth 90 is -z of a y-up file
    seen, _ = apply_cuts(complete, FRAME, [ScanCut(((0.0, 0.0),))], (), "shell")
    assert float(seen.means[:, 0].min()) > 10.2
    assert len(seen) > 0.2 * len(complete)
    box = parse_box("10,0.5,0,2,0.5,2")
    both, steps = apply_cuts(complete, FRAME, [PlaneCut(0.0)], [box], "shell")
    assert float(both.means[:, 1].min()) >= 0
    assert [step.name for step in steps] == ["cut_plane", "boxes"]


def test_nothing_and_everything_are_user_errors() -> None:
    for cut in (PlaneCut(0.0, 5.0), PlaneCut(0.0, -5.0)):
        with pytest.raises(UserError, match="shell: cut"):
            apply_cuts(shell(50), FRAME, [cut], (), "shell")


@pytest.mark.parametrize("away", [1.5, 5.0, 50.0])
def test_a_floater_does_not_change_what_a_scanner_sees(away: float) -> None:
    complete = BALL
    clean = ScanCut(((0.0, 20.0),)).apply(complete).mask
    floater = dataclasses.replace(
        complete.select(torch.tensor([0])), means=torch.tensor([[away, 0.0, 0.0]])
    )
    seen = ScanCut(((0.0, 20.0),)).apply(concatenate([complete, floater])).mask[:-1]
    assert (seen == clean).float().mean() > 0.99
