"""Planes are fitted to where points end."""

import numpy as np
import pytest

from gscomplete.splats.geometry.upright_plane import UprightPlane, fitted_to_edge
from tests.builders.objects import ball

BALL = ball().means.double().numpy()


@pytest.mark.parametrize("azimuth_deg", [0.0, 37.0, 200.0])
@pytest.mark.parametrize("offset", [-0.2, 0.0, 0.15])
@pytest.mark.parametrize(("turn_deg", "shift"), [(2.0, 0.003), (-4.0, -0.004), (0.0, 0.0)])
def test_a_plane_is_fitted_to_the_edge(azimuth_deg, offset, turn_deg, shift):
    """Splats are .0085 apart; measured: .57 degrees, and .0055 inside the cut at most."""
    rough = UprightPlane(azimuth_deg + turn_deg, offset + shift)
    kept = BALL[BALL @ UprightPlane(azimuth_deg, offset).normal < offset]
    found = fitted_to_edge(kept, rough)
    assert abs((found.azimuth_deg - azimuth_deg + 180) % 360 - 180) < 0.7
    assert -0.0085 < found.offset - offset < 0.001


def test_a_plane_without_an_edge_is_left_as_it_is():
    plane = UprightPlane(30.0, 2.0)
    assert fitted_to_edge(BALL, plane) is plane
    assert fitted_to_edge(np.zeros((50, 3)), UprightPlane(0.0, 0.0)) == UprightPlane(0.0, 0.0)
