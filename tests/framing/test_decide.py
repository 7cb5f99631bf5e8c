"""What users give about frame and views is checked at once."""

import math

import pytest

from gscomplete.errors import UserError
from gscomplete.framing.decide import FramingRequest


@pytest.mark.parametrize("size", [0.0, -1.0, math.nan, math.inf, -math.inf])
def test_a_size_that_is_no_length_is_refused(size: float) -> None:
    with pytest.raises(UserError, match="--object-size: expected a positive length, found"):
        FramingRequest(size_file=size)


@pytest.mark.parametrize("odd", [math.nan, math.inf])
def test_a_centre_that_is_nowhere_is_refused(odd: float) -> None:
    with pytest.raises(UserError, match=r"--center: expected three finite numbers, found 0,.*,1"):
        FramingRequest(center_file=(0.0, odd, 1.0))
