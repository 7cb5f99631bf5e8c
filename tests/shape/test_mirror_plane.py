"""What users mirror through is checked when it is made, and written as they write it."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gscomplete.errors import UserError
from gscomplete.shape.mirror_plane import HalfCut, MirrorPlane

AZIMUTHS, OFFSETS = st.floats(-1e6, 1e6), st.floats(-1.0, 1.0)
BEYOND = [math.nextafter(1e6, math.inf), -math.nextafter(1e6, math.inf), 1e300]
NO_NUMBERS = [math.nan, math.inf, -math.inf]


@given(AZIMUTHS, OFFSETS)
def test_a_plane_within_the_ranges_is_written_to_a_tenth_of_a_degree(azimuth_deg, offset):
    azimuth, aside = str(MirrorPlane(azimuth_deg, offset)).split(",")
    assert float(azimuth) == pytest.approx(azimuth_deg, abs=0.05 + 1e-9)
    assert float(aside) == pytest.approx(offset, abs=0.0005 + 1e-12)
    assert (len(azimuth.partition(".")[2]), len(aside.partition(".")[2])) == (1, 3)
    assert "-0.0," not in f"{azimuth},"
    assert aside != "-0.000"


@given(AZIMUTHS, OFFSETS)
def test_a_plane_that_is_read_back_is_written_the_same(azimuth_deg, offset):
    text = str(MirrorPlane(azimuth_deg, offset))
    assert str(MirrorPlane(*map(float, text.split(",")))) == text


@pytest.mark.parametrize(
    ("plane", "text"),
    [
        (MirrorPlane(30.0, 0.1), "30.0,0.100"),
        (MirrorPlane(-0.0, -0.0), "0.0,0.000"),
        (MirrorPlane(-0.04, -0.0004), "0.0,0.000"),
        (MirrorPlane(-1e6, -1.0), "-1000000.0,-1.000"),
        (HalfCut(), "cut"),
        (HalfCut(0.0), "cut:0"),
        (HalfCut(-30.5), "cut:-30.5"),
    ],
)
def test_planes_and_halves_are_written_as_users_write_them(plane, text):
    assert str(plane) == text


@pytest.mark.parametrize("azimuth_deg", BEYOND + NO_NUMBERS)
def test_azimuths_beyond_their_range_and_no_numbers_are_refused(azimuth_deg):
    found = "expected an azimuth of -1e6 to 1e6 degrees, found"
    with pytest.raises(UserError, match=f"^mirror: azimuth_deg: {found}"):
        MirrorPlane(azimuth_deg, 0.0)
    with pytest.raises(UserError, match=f"^mirror: cut: {found}"):
        HalfCut(azimuth_deg)


@pytest.mark.parametrize("offset", [math.nextafter(1, 2), -math.nextafter(1, 2), *NO_NUMBERS])
def test_offsets_beyond_an_object_size_and_no_numbers_are_refused(offset):
    with pytest.raises(UserError, match=r"^mirror: offset: expected -1 to 1 object sizes, found"):
        MirrorPlane(0.0, offset)


def test_a_plane_stays_what_was_checked():
    with pytest.raises(dataclasses.FrozenInstanceError):
        MirrorPlane(0.0, 0.0).offset = 2.0  # type: ignore[misc]
    with pytest.raises(UserError, match="offset"):
        dataclasses.replace(MirrorPlane(0.0, 0.0), offset=2.0)
