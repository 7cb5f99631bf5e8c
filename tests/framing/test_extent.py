import dataclasses

import numpy as np
import pytest

from gscomplete.framing.cut_plane import CutPlane, find_cut
from gscomplete.framing.extent import (
    CLOSED_BELOW,
    CLOSED_BELOW_FINELY,
    is_closed,
    share_exposed_twice,
)
from tests.builders.objects import ball, half


def closed(points):
    return is_closed(points, find_cut(points), lambda: 0.0)


def points_of_ball(count=6000):
    return ball(count).means.double().numpy()


@pytest.mark.parametrize("count", [1500, 6000, 30_000])
def test_a_closed_surface_is_seen_from_one_side(count):
    assert share_exposed_twice(points_of_ball(count)) < CLOSED_BELOW / 2
    assert closed(points_of_ball(count))


def test_an_open_shell_is_seen_from_both_sides():
    points = half(ball()).means.double().numpy()
    # The inside of half a ball shows but for its rim, which is seen too steeply.
    assert share_exposed_twice(points) > 0.5
    assert not closed(points)


def test_a_hole_below_is_not_seen_and_one_above_is():
    points = points_of_ball()
    assert closed(points[points[:, 2] > -0.3])
    assert not closed(points[points[:, 2] < 0.3])


def test_half_a_cup_of_two_walls_is_not_closed():
    directions = points_of_ball() / 0.4
    walls = np.concatenate([0.4 * directions, 0.385 * directions])
    below = walls[walls[:, 2] < 0.2]
    assert share_exposed_twice(below[below[:, 0] > 0]) < 0.05
    assert not closed(below[below[:, 0] > 0])


def test_place_size_and_order_do_not_matter():
    points = half(ball()).means.double().numpy()
    moved = 1e3 * points + [5e3, -2e3, 1e2]
    few = 3 / len(points)  # a point on a limit may fall to either side
    assert share_exposed_twice(moved) == pytest.approx(share_exposed_twice(points), abs=few)
    shuffled = np.random.default_rng(0).permutation(points)
    assert share_exposed_twice(shuffled) == pytest.approx(share_exposed_twice(points), abs=few)


def test_too_few_points_are_not_closed():
    assert not closed(np.zeros((5, 3)))
    assert not closed(np.zeros((50, 3)))


def with_fin(thickness):
    """A ball of radius 0.4 with a closed fin of two sides on top, points of one spacing."""
    body = points_of_ball(26_000)
    side = np.sqrt(2.0106 / 26_000)  # what a point of the ball stands for
    x, z = (np.arange(0, length, side) for length in (0.3, 0.2))
    face = np.stack(np.meshgrid(x - 0.15, z + 0.35, indexing="ij"), axis=-1).reshape(-1, 2)
    walls = [np.insert(face, 1, y, axis=1) for y in (-thickness / 2, thickness / 2)]
    rim = np.array([[a, y, b] for a, b in face[face[:, 1] == face[:, 1].max()] for y in (0.0,)])
    return np.concatenate([body, *walls, rim])


def test_many_points_tell_apart_what_few_do_not():
    fin = with_fin(0.012)
    assert share_exposed_twice(fin, 8000) > CLOSED_BELOW
    assert share_exposed_twice(fin) < CLOSED_BELOW_FINELY
    assert closed(fin)


def test_of_thin_things_many_points_are_not_asked():
    fin = with_fin(0.012) * [1.0, 1.0, 0.1]
    assert share_exposed_twice(fin, 8000) > CLOSED_BELOW
    assert share_exposed_twice(fin) < CLOSED_BELOW_FINELY
    assert not closed(fin)


def blade(step=0.003):
    """A closed blade that is thinner towards both edges, 0.2 wide and 1 high."""

    def half_thickness(x):
        return 0.03 - 0.22 * np.abs(x)

    across, height = np.arange(-0.1, 0.1 + step / 2, step), np.arange(-0.5, 0.5 + step / 2, step)
    x, z = (grid.ravel() for grid in np.meshgrid(across, height, indexing="ij"))
    found = [np.stack([x, sign * half_thickness(x), z], axis=1) for sign in (-1.0, 1.0)]
    y = np.arange(-0.03, 0.03, step)
    for end in (-0.1, 0.1):
        found.append(np.array([(end, v, w) for v in y for w in height if abs(v) < 0.008]))
        found.append(np.array([(u, v, 5 * end) for u in across for v in y
                               if abs(v) < half_thickness(u)]))  # fmt: skip
    return np.concatenate(found)


def test_sharp_edges_that_pass_for_a_cut_leave_a_blade_closed():
    cut = find_cut(blade())
    assert cut is not None
    assert not cut.is_symmetric
    assert closed(blade())
    assert not closed(blade()[blade()[:, 1] > 0])


def test_only_a_cut_met_at_a_slant_beside_walls_along_it_is_an_edge():
    fin = with_fin(0.012)
    edge = CutPlane(0.0, 0.0, 0.9, 0.1, 0.6, 0.9)
    assert is_closed(fin, edge, lambda: 1.0)
    assert not is_closed(
        fin, dataclasses.replace(edge, squareness=0.8, mean_cosine=0.2), lambda: 0.0
    )
    assert not is_closed(fin, dataclasses.replace(edge, wall_cosine=0.4), lambda: 0.0)


@pytest.mark.parametrize(
    ("few", "openness", "expected"),
    [(0.004, 0.5, False), (0.004, 0.2, True), (0.0001, 0.5, True)],
)
def test_what_shows_a_little_of_its_inside_and_is_open_to_one_side_is_not_closed(
    monkeypatch, few, openness, expected
):
    monkeypatch.setattr(
        "gscomplete.framing.extent.share_exposed_twice", lambda points, most_points=24_000: few
    )
    assert is_closed(points_of_ball(), None, lambda: openness) is expected


def test_openness_is_asked_of_closed_surfaces_alone():
    def openness():
        raise AssertionError("asked")

    assert not is_closed(points_of_ball()[points_of_ball()[:, 0] > 0], None, openness)


@pytest.mark.parametrize(("many", "expected"), [(0.016, False), (0.004, True)])
def test_many_points_may_contradict_few_that_see_no_inside(monkeypatch, many, expected):
    def share(points, most_points=24_000):
        return 0.006 if most_points == 8000 else many

    monkeypatch.setattr("gscomplete.framing.extent.share_exposed_twice", share)
    assert is_closed(points_of_ball(), None, lambda: 0.0) is expected


def test_what_is_cut_squarely_or_has_no_thickness_is_not_closed():
    square = CutPlane(0.0, 0.0, 0.9, 0.9, 0.05)
    assert square.is_symmetric
    assert not is_closed(blade(), square, lambda: 0.0)
    flat = blade() * [5.0, 0.05, 1.0]
    assert not is_closed(flat, dataclasses.replace(square, squareness=0.1), lambda: 0.0)
