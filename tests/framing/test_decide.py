"""What users give about frame and views is checked at once."""

import math

import numpy as np
import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.framing.decide import FramingRequest, decide_framing
from tests.builders.objects import ball


@pytest.mark.parametrize("size", [0.0, -1.0, math.nan, math.inf, -math.inf, 5e-324])
def test_a_size_that_is_no_length_is_refused(size: float) -> None:
    with pytest.raises(UserError, match="--object-size: expected a positive length, found"):
        FramingRequest(size_file=size)


@pytest.mark.parametrize("odd", [math.nan, math.inf])
def test_a_centre_that_is_nowhere_is_refused(odd: float) -> None:
    with pytest.raises(UserError, match=r"--center: expected three finite numbers, found 0,.*,1"):
        FramingRequest(center_file=(0.0, odd, 1.0))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"up": "W"}, "up: expected one of Z, .*found 'W'"),
        ({"view_deg": (5.0,)}, "view_deg: expected an azimuth and an elevation .*found 5"),
        ({"view_deg": (5.0, 91.0)}, "view_deg: expected .*found 5,91"),
        ({"azimuth_range_deg": 181.0}, "azimuth_range_deg: expected 0 to 180 degrees, found 181"),
        ({"elevation_range_deg": math.nan}, "elevation_range_deg: expected 0 to 90 .*found nan"),
    ],
)
def test_angles_and_directions_out_of_range_are_refused(given, message) -> None:
    with pytest.raises(UserError, match=message):
        FramingRequest(**given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"up": (0, 0, 1)}, r"up: expected one of Z, .*found \(0, 0, 1\)"),
        ({"up": [0, 0, 1]}, r"up: expected one of Z, .*found \[0, 0, 1\]"),
        ({"up": None}, "up: expected an axis or a direction, found None"),
        ({"view_deg": "30,10"}, "view_deg: expected an azimuth and an elevation .*found '30,10'"),
        ({"view_deg": "12"}, "view_deg: expected an azimuth and an elevation .*found '12'"),
        ({"view_deg": ("a", "b")}, r"view_deg: expected .*found \('a', 'b'\)"),
        ({"view_deg": 30}, "view_deg: expected .*found 30"),
        ({"center_file": (0, 0)}, "--center: expected three finite numbers, found 0,0"),
        ({"center_file": "0,0,0"}, "--center: expected three finite numbers, found '0,0,0'"),
        ({"center_file": ("a", 0, 0)}, r"--center: expected three .*found \('a', 0, 0\)"),
        ({"size_file": "1"}, "--object-size: expected a positive length, found '1'"),
        ({"azimuth_range_deg": "3"}, "azimuth_range_deg: expected 0 to 180 degrees, found '3'"),
        ({"elevation_range_deg": None}, "elevation_range_deg: expected 0 to 90 .*found None"),
    ],
)
def test_values_of_other_types_are_refused(given, message) -> None:
    with pytest.raises(UserError, match=message):
        FramingRequest(**given)


@pytest.mark.parametrize("kind", [list, np.array, torch.tensor])
def test_any_sequence_of_numbers_is_taken(kind) -> None:
    found = FramingRequest(view_deg=kind([30.0, 10.0]), center_file=kind([0.0, 1.0, 2.0]))
    assert found == FramingRequest(view_deg=(30.0, 10.0), center_file=(0.0, 1.0, 2.0))


@pytest.mark.parametrize(("count", "message"), [(0, "P has no splat"), (1, "framing: .*")])
def test_a_part_of_next_to_nothing_is_refused(count: int, message: str) -> None:
    part = ball(100).select(torch.arange(count))
    with pytest.raises(UserError, match=message):
        decide_framing(part, FramingRequest("Z"))
