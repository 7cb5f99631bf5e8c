"""Inner sides of vessels and fragments are joined again; what stands behind an object is not."""

from dataclasses import replace

import numpy as np
import pytest

from splatcomplete_data.scan.rejoin import Cubes, bend, rejoin
from splatcomplete_data.scan.segments import object_at
from tests.builders.table_top import EYE, SPACING, box, cup, table_top

RADIUS = 0.08
CUP = cup((0.0, 0.0), RADIUS, 0.16)


def share_taken(parts, seed_part, viewpoint=EYE, where=None):
    """Return the share of every part's points that a seed on one of them takes."""
    cloud = table_top(parts)
    standing = cloud.select(np.flatnonzero((cloud.labels > 0) & (cloud.points[:, 2] > 0.008)))
    own = parts[seed_part]
    seed = own[np.square(own - EYE).sum(axis=1).argmin()] if where is None else where
    taken = object_at(standing.points, standing.colors, seed, SPACING, viewpoint=viewpoint)
    return [taken[standing.labels == 1 + part].mean() for part in range(len(parts))]


def test_the_builder_shows_both_sides_of_a_cup():
    is_inner = CUP[:, 1] > 0.03
    assert 0.1 < is_inner.mean() < 0.5
    assert CUP[is_inner, 2].min() > 0.03  # the near rim hides what is lower


@pytest.mark.parametrize("seed", [(0, -RADIUS, 0.08), (0, RADIUS, 0.15)])
def test_a_seed_on_either_side_of_a_cup_takes_both(seed):
    assert share_taken([CUP], 0, where=np.array(seed))[0] > 0.97


@pytest.mark.parametrize(
    "behind",
    [
        box((0.0, RADIUS + 0.09), (0.2, 0.12, 0.2)),
        cup((0.0, 0.25), 0.08, 0.2),
        # a wide half pipe, open to the camera: concave, and the cup hides some of it
        np.stack(
            [
                0.3 * np.cos(a := np.tile(np.arange(0.2, np.pi - 0.2, 0.02), 40)),
                0.3 * np.sin(a) - 0.15,
                np.repeat(np.arange(40) * SPACING, len(a) // 40),
            ],
            axis=1,
        ),
    ],
    ids=["box", "cup", "half pipe"],
)
def test_what_stands_behind_a_cup_is_not_its_inner_side(behind):
    own, other = share_taken([CUP, behind], 0)
    assert own > 0.9
    assert other < 0.02


@pytest.mark.parametrize(("width", "is_taken"), [(0.03, True), (0.12, False)])
def test_a_fragment_joins_what_it_touches(width, is_taken):
    """The table-top's own box with a small box before it, which a concave fold parts from it."""
    body = box((0.0, 0.0), (0.3, 0.2, 0.2))
    part = box((0.0, -0.1 - width / 2), (width, width, width))
    own, other = share_taken([body, part], 0)
    assert own > 0.97
    assert (other > 0.9) if is_taken else (other < 0.1)


def row_of_cubes(places):
    """Return cubes of one point each that face up, neighbours where they are 1 apart."""
    means = np.array([[float(x), 0, 0] for x in places])
    pairs = [(i, i + 1) for i in range(len(places) - 1) if places[i + 1] - places[i] == 1]
    normals = np.tile([0.0, 0.0, 1.0], (len(places), 1))
    return Cubes(
        means, normals, np.ones(len(places)), np.array(pairs, np.int64).reshape(-1, 2), 1.0
    )


@pytest.mark.parametrize(
    ("fragment", "is_joined"),
    [([40, 41], True), ([41, 42], True), ([42, 43], False), ([40, 41, 42], False)],
    ids=["touches", "near", "far", "too large"],
)
def test_fragments_join_what_they_touch_or_what_is_near(fragment, is_joined):
    row = row_of_cubes([*range(40), *fragment])
    joined = rejoin(np.repeat([0, 1], [40, len(fragment)]), row, None)
    assert (joined[40:] == joined[0]).tolist() == [is_joined] * len(fragment)


@pytest.mark.parametrize("host", [0, 2])
def test_a_fragment_joins_the_longest_contact(host):
    """One cube touches the 30 before it once, and the 30 after it twice, or the other way round."""
    row = row_of_cubes(range(61))
    beside = 28 if host == 0 else 32
    pairs = np.concatenate([row.pairs, [[min(beside, 30), max(beside, 30)]]])
    labels = np.repeat([0, 1, 2], [30, 1, 30])
    joined = rejoin(labels, replace(row, pairs=pairs), None)
    assert joined[30] == joined[labels == host][0]
    assert len(set(joined.tolist())) == 2


def test_bend_of_half_balls_and_planes():
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals[normals[:, 2] > 0]
    up = np.tile([0.0, 0.0, 1.0], (len(normals), 1))
    places = [normals, 9 - normals, normals * [1, 1, 0] - 9]
    cubes = Cubes(
        np.concatenate(places),
        np.concatenate([normals, normals, up]),
        np.ones(3 * len(normals)),
        np.zeros((0, 2), np.int64),
        1.0,
    )
    labels = np.repeat([0, 1, 2], len(normals))
    assert bend(cubes, labels) == pytest.approx([1, -1, 0])


def test_no_cubes_touch_each_other():
    alone = row_of_cubes([0, 5, 10])
    assert rejoin(np.array([4, 7, 9]), alone, np.zeros(3)).tolist() == [0, 1, 2]
