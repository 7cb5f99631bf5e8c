"""The frame of a known whole is that of its splats, not of an odd one among them."""

import dataclasses

import pytest

from splatcomplete_data.framing import frame_of_whole
from tests.splatcomplete_data.balls import BALL


def test_one_huge_splat_does_not_decide_the_size() -> None:
    scales = BALL.scales.clone()
    scales[7] = 1000.0
    frame = frame_of_whole(dataclasses.replace(BALL, scales=scales), "Z")
    assert frame.size_file == pytest.approx(1.0, abs=0.01)
    assert frame.size_file == frame_of_whole(BALL, "Z").size_file


def test_a_single_splat_has_a_frame() -> None:
    frame = frame_of_whole(BALL.select(slice(0, 1)), "Z")
    assert frame.size_file == pytest.approx(float(BALL.scales[0].max()))
