import numpy as np
import pytest

from gscomplete.shape.planes.features import ANGLES, OFFSETS
from gscomplete.shape.voxels import CELLS
from recipes.train_embedded_prior.data.copies import Truth, cells_away
from tests.builders.objects import ball, half
from tests.builders.shape_network import mirrors

MIDDLE = OFFSETS.index(0.0)


def test_a_copy_scores_what_it_shows_of_the_missing():
    truth = Truth.of(half(ball()), ball())
    score = truth.plane_scores()
    assert score.shape == (ANGLES, len(OFFSETS))
    assert score[0, MIDDLE] > 0.9  # the cut itself: all of the other half
    assert abs(score[ANGLES // 2, MIDDLE]) < 0.1  # a copy onto P shows nothing and harms nothing
    assert score[0, MIDDLE + 12] < 0.0  # a copy in front of P is nothing but wrong


def test_maps_score_as_their_planes_do():
    truth = Truth.of(half(ball()), ball())
    score = truth.plane_scores()
    across, along, turned = mirrors()
    # Points on the border of two cells may fall on the other side.
    assert truth.map_score(across) == pytest.approx(score[0, MIDDLE], abs=0.02)
    assert truth.map_score(along) == pytest.approx(score[ANGLES // 2, MIDDLE], abs=0.02)
    assert truth.map_score(turned) > 0.9


def test_nothing_missing_scores_nothing():
    score = Truth.of(ball(), ball()).plane_scores()
    assert not score.any()
    assert np.isfinite(score).all()


def test_distances_are_to_the_nearest_filled_cell():
    filled = np.zeros((CELLS,) * 3, bool)
    assert (cells_away(filled) == CELLS).all()
    filled[3, 4, 5] = filled[40, 4, 5] = True
    away = cells_away(filled)
    assert away[3, 4, 5] == 0
    assert away[6, 8, 5] == pytest.approx(5.0)
    assert away[39, 4, 7] == pytest.approx(5**0.5)
