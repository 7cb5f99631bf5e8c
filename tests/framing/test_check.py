"""Frames that users give are checked against P."""

from pathlib import Path

import pytest

from gscomplete.errors import UserError
from gscomplete.framing.check import check_given_frame
from gscomplete.views import ObjectFrame
from tests.completion.cylinders import cylinder


@pytest.mark.parametrize("up", ["Z", "-Y"])
@pytest.mark.parametrize(
    ("center", "size", "found"),
    [
        ((0.0, 0.0, 0.0), 1.0, None),
        ((0.5, 0.0, 0.0), 1.5, None),
        ((0.0, 0.0, 0.0), 19.0, None),  # 5.3 %
        ((0.0, 0.0, 0.0), 40.0, "2.5 % of the complete object's 40"),
        ((0.0, 0.0, 0.0), 0.4, "reaches 0.3 beyond"),
        ((0.0, 0.0, 0.0), 0.6, None),  # beyond by 0.2, a third of the size
    ],
)
def test_frames_that_may_be_the_wholes_are_taken(up, center, size, found):
    notes = check_given_frame(cylinder(), ObjectFrame(up, center, size), Path("p.ply"))
    assert len(notes) == (found is not None)
    assert found is None or found in notes[0]


def test_what_is_astronomically_far_away_does_not_count() -> None:
    part = cylinder(60)
    part.means[0] = 1e17
    assert check_given_frame(part, ObjectFrame("Z", (0.0, 0.0, 0.0), 1.0), "p.ply") != ()


@pytest.mark.parametrize(
    ("center", "size", "message"),
    [
        (
            (0.0, 0.0, 0.0),
            1000.0,
            r"p\.ply: --object-size: expected 0\.1 to 100 .*found 1000.*0\.1 %",
        ),
        ((0.0, 0.0, 0.0), 1e9, r"--object-size: expected 0\.1 to 100 .*found 1e\+09"),
        ((0.0, 0.0, 0.0), 1e-9, r"--object-size: expected 0\.1 to 100 .*found 1e-09"),
        ((0.0, 0.0, 0.0), 0.09, r"--object-size: expected 0\.1 to 100 .*found 0\.09"),
        (
            (0.0, 2.0, 0.0),
            1.0,
            r"p\.ply: --center, --object-size: expected a frame.*from -0\.5,1\.5,-0\.5",
        ),
        ((-900.0, 0.0, 0.0), 90.0, "expected a frame that P lies in"),
    ],
)
def test_frames_that_cannot_be_the_wholes_are_refused_with_the_numbers(center, size, message):
    with pytest.raises(UserError, match=message):
        check_given_frame(cylinder(), ObjectFrame("Z", center, size), Path("p.ply"))
