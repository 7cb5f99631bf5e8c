import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gscomplete.shape.surface.depth import FEATURES
from gscomplete.shape.voxels import CELL_SIDE
from recipes.train_embedded_prior.small_networks import depth_sets
from recipes.train_embedded_prior.small_networks.depth_sets import (
    depth_sets_of,
    first_depths,
    made_with,
)
from recipes.train_embedded_prior.small_networks.object_tasks import ObjectTask, train_entries
from tests.builders.mesh_pack import write_pack

UP = np.array([[0, 0, 1]], np.float32)
ORIGIN = np.zeros((1, 3), np.float32)


def walls(*depths):
    """Return distances of places from level walls that lie so many cells below the origin."""
    return lambda places: np.min(
        [np.abs(places[:, 2] / CELL_SIDE + depth) for depth in depths], axis=0
    )


@given(st.floats(-1.9, 3.9))
def test_a_wall_is_found_where_it_is(depth):
    # Looked for in steps of a quarter cell.
    assert first_depths(walls(depth), ORIGIN, UP)[0] == pytest.approx(depth, abs=0.13)


def test_sets_of_answers_in_other_placements_are_not_used(monkeypatch):
    before = made_with()
    assert made_with() == before
    monkeypatch.setattr(depth_sets, "placements", tuple)
    assert made_with() != before


def test_of_two_walls_the_outer_one_counts():
    assert first_depths(walls(0.5, 2.0), ORIGIN, UP)[0] == 0.5


def test_beyond_reach_is_nothing():
    assert np.isnan(first_depths(walls(9.0), ORIGIN, UP)[0])
    assert np.isnan(first_depths(walls(-3.0), ORIGIN, UP)[0])


def test_a_wall_that_is_passed_by_is_nothing():
    def beside(places):
        return np.hypot(places[:, 2] / CELL_SIDE + 1, 0.6)

    assert np.isnan(first_depths(beside, ORIGIN, UP)[0])


def test_sets_are_a_function_of_the_object(tmp_path, monkeypatch):
    monkeypatch.setattr(depth_sets, "_KINDS", ("half",))  # one part; a guess takes seconds
    pack = write_pack(tmp_path)
    entry = train_entries(pack, 3, 100)[0]
    made, again = (depth_sets_of(ObjectTask(pack, entry, 3)) for _ in range(2))
    assert made.features.shape == (len(made), len(FEATURES))
    assert len(made) > 0
    assert len(made.insets) == len(made)
    np.testing.assert_array_equal(made.features, again.features)
    np.testing.assert_array_equal(made.depths, again.depths)
