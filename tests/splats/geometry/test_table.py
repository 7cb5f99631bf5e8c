"""The patch of table below a part."""

import numpy as np
import pytest

from gscomplete.splats.geometry.table import table_rows
from tests.builders.objects import ball, cylinder, half

BALL = ball(4000).means.double().numpy()
CYLINDER = cylinder(6000).means.double().numpy()


def patch(half_side: float, count: int, height: float, thickness: float = 0.002) -> np.ndarray:
    rng = np.random.default_rng(1)
    points = rng.uniform(-half_side, half_side, (count, 3))
    points[:, 2] = height + thickness * rng.standard_normal(count)
    return points


@pytest.mark.parametrize("upon", [BALL, CYLINDER], ids=["ball", "cylinder"])
@pytest.mark.parametrize("unit", [1e-3, 1.0, 250.0])
def test_a_table_is_found_and_what_stands_on_it_is_not(upon, unit):
    table = patch(0.6, 2000, float(upon[:, 2].min()))
    marked = table_rows(unit * np.concatenate([upon, table]))
    assert marked[len(upon) :].all()
    high = upon[:, 2] > upon[:, 2].min() + 0.03
    assert not marked[: len(upon)][high].any()


def test_it_ends_where_the_part_was_cut():
    """A scan shows the table on one side only."""
    near = half(ball(4000)).means.double().numpy()
    table = patch(0.6, 2000, float(near[:, 2].min()))
    table = table[table[:, 0] > 0.05]
    marked = table_rows(np.concatenate([near, table]))
    assert marked[len(near) :].all()


@pytest.mark.parametrize("upon", [BALL, CYLINDER], ids=["ball", "cylinder"])
def test_objects_alone_have_none(upon):
    assert not table_rows(upon).any()
    assert not table_rows(upon[:, [1, 2, 0]]).any()


def test_a_foot_within_the_outline_is_none():
    """A wide lamp on a flat base: the base does not reach beyond what stands on it."""
    shade = patch(0.5, 4000, 0.6, 0.05)
    base = patch(0.25, 2000, 0.0)
    pole = np.zeros((400, 3))
    pole[:, 2] = np.linspace(0.03, 0.6, 400)
    assert not table_rows(np.concatenate([shade, base, pole])).any()


def test_a_flat_object_is_no_table():
    assert not table_rows(patch(0.5, 3000, 0.0)).any()


@pytest.mark.parametrize("case", ["none", "few", "one place", "line"])
def test_extremes_have_an_answer(case):
    points = {
        "none": np.zeros((0, 3)),
        "few": BALL[:200],
        "one place": np.ones((500, 3)),
        "line": np.linspace(0, 1, 500)[:, None] * np.array([1.0, 0.0, 0.0]),
    }[case]
    assert table_rows(points).shape == (len(points),)
    assert not table_rows(points).any()


def test_what_stands_on_one_line_needs_no_outline():
    wall = np.zeros((500, 3))
    wall[:, 0], wall[:, 2] = np.linspace(-0.3, 0.3, 500), np.tile(np.linspace(0.05, 0.8, 50), 10)
    marked = table_rows(np.concatenate([wall, patch(0.4, 2000, 0.0)]))
    assert marked[500:].all()
    assert not marked[:500].any()
