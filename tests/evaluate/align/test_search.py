"""Steps of the coarse alignment beside plain float64 loops, and where they lead."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gscomplete.evaluate.align.nearest_grid import CELLS, REACH, NearestGrid, nearest_grid
from gscomplete.evaluate.align.search import _look_up, even_rotations, improve

SIDE = 2 * REACH / CELLS
PART = np.random.default_rng(0).uniform(-0.4, 0.4, (60, 3)) * [1.0, 0.7, 0.4]
WHOLE = np.random.default_rng(1).uniform(-0.5, 0.5, (90, 3)) * [1.0, 0.7, 0.4]


def slow_look_up(grid: NearestGrid, place) -> np.ndarray:
    """Return the grid's point at a place moved into the cube."""
    cell = np.clip(np.floor((place + REACH) / SIDE), 0, CELLS - 1).astype(int)
    return grid.points[grid.index[tuple(cell)]]


def slow_improve(part, complete, start, covered, iterations, scale_range):
    """Take steps from one start as the module's conventions say; return it and its cost."""
    part_grid, complete_grid = nearest_grid(part), nearest_grid(complete)
    rotation, scale, shift = start
    for step in range(iterations + 1):
        pairs = []
        for x in part:
            moved = scale * rotation @ x + shift
            other = slow_look_up(complete_grid, moved)
            pairs.append((((moved - other) ** 2).sum(), x, other))
        back = []
        for y in complete:
            moved = rotation.T @ (y - shift) / scale
            other = slow_look_up(part_grid, moved)
            back.append((((moved - other) ** 2).sum() * scale**2, other, y))
        kept = []
        for both, share in ((pairs, 0.9), (back, covered)):
            number = max(4, int(share * len(both)))
            limit = sorted(pair[0] for pair in both)[number - 1]
            kept += [(1 / number, *pair) for pair in both if pair[0] <= limit]
        weight, squared = (np.array([pair[k] for pair in kept]) for k in (0, 1))
        source, target = (np.array([pair[k] for pair in kept]) for k in (2, 3))
        cost = float((weight * squared).sum())
        if step == iterations:
            break
        share = (weight / weight.sum())[:, None]
        a, b = source - (share * source).sum(axis=0), target - (share * target).sum(axis=0)
        turn, _ = Rotation.align_vectors(b, a, weights=weight)
        rotation = turn.as_matrix()
        ratio = np.sqrt((share * b**2).sum() / (share * a**2).sum())
        scale = float(np.clip(ratio, *scale_range))
        shift = (share * target).sum(axis=0) - scale * rotation @ (share * source).sum(axis=0)
    return rotation, scale, shift, cost


def improved(part, complete, starts, **options):
    """Run the module on copies of starts; return rotations, scales, translations and costs."""
    rotations, scales, shifts = (np.array([start[k] for start in starts]) for k in range(3))
    costs = improve(
        part, complete, nearest_grid(part), nearest_grid(complete), rotations, scales, shifts,
        **options,
    )  # fmt: skip
    return rotations, scales, shifts, costs


def starts(count: int):
    rng = np.random.default_rng(5)
    turns = even_rotations(count)
    return [(turns[k], rng.uniform(0.6, 1.4), rng.uniform(-0.1, 0.1, 3)) for k in range(count)]


@given(st.tuples(*[st.floats(-3, 3)] * 3))
def test_a_place_is_looked_up_in_its_cell_or_the_border(place):
    grid = nearest_grid(WHOLE)
    scaled = (np.array(place) + REACH) / SIDE
    if np.abs(scaled - np.round(scaled)).max() < 1e-9:  # either of two cells
        return
    found = grid.points[_look_up(grid.index, *place)]
    assert np.array_equal(found, slow_look_up(grid, np.array(place)))


@pytest.mark.parametrize("iterations", [0, 1, 3])
@pytest.mark.parametrize("covered", [0.05, 0.5, 1.0])
def test_steps_are_those_of_plain_loops(iterations, covered):
    given_starts = starts(6)
    found = improved(
        PART, WHOLE, given_starts, covered=covered, iterations=iterations, scale_range=(0.8, 1.2)
    )
    for number, start in enumerate(given_starts):
        expected = slow_improve(PART, WHOLE, start, covered, iterations, (0.8, 1.2))
        for mine, theirs in zip(found, expected, strict=True):
            # float64 throughout; a rotation is known to the root of 1e-16 where two suit alike
            assert mine[number] == pytest.approx(theirs, abs=1e-7)


def test_no_step_leaves_a_start_as_it_is():
    given_starts = starts(4)
    rotations, scales, shifts, costs = improved(
        PART, WHOLE, given_starts, covered=0.5, iterations=0, scale_range=(1.0, 1.0)
    )
    for number, (rotation, scale, shift) in enumerate(given_starts):
        assert np.array_equal(rotations[number], rotation)
        assert (scales[number], shifts[number].tolist()) == (scale, shift.tolist())
    assert (costs > 0).all()


def test_starts_do_not_depend_on_each_other():
    together = improved(PART, WHOLE, starts(5), covered=0.5, iterations=2, scale_range=(0.5, 2.0))
    for number, start in enumerate(starts(5)):
        alone = improved(PART, WHOLE, [start], covered=0.5, iterations=2, scale_range=(0.5, 2.0))
        for one, of_all in zip(alone, together, strict=True):
            assert np.array_equal(one[0], of_all[number])


def test_steps_lead_to_a_small_turn():
    turn = Rotation.from_rotvec([0.05, -0.04, 0.08]).as_matrix()
    whole = 1.05 * PART @ turn.T + 0.02
    start = [(np.eye(3), 1.0, np.zeros(3))]
    rotations, scales, _, costs = improved(
        PART, whole, start, covered=1.0, iterations=25, scale_range=(0.5, 2.0)
    )
    assert Rotation.from_matrix(rotations[0] @ turn.T).magnitude() < 0.01
    assert scales[0] == pytest.approx(1.05, abs=0.01)
    assert costs[0] < 2 * SIDE**2  # a look-up errs by about a cell


def test_rotations_of_flat_clouds_are_proper():
    """Through the plane of a flat cloud a mirror image suits as well as a rotation."""
    rotations, _, _, costs = improved(
        PART * [1, 1, 0], WHOLE * [1, 1, 0], starts(30), covered=0.5, iterations=1,
        scale_range=(0.5, 2.0),
    )  # fmt: skip
    assert np.isfinite(costs).all()
    assert np.linalg.det(rotations) == pytest.approx(np.ones(30), abs=1e-12)
    assert rotations @ rotations.transpose(0, 2, 1) == pytest.approx(
        np.broadcast_to(np.eye(3), (30, 3, 3)), abs=1e-12
    )


def test_scales_are_kept_within_their_range():
    for low, high in ((0.2, 0.3), (3.0, 4.0)):
        _, scales, _, _ = improved(
            PART, WHOLE, starts(3), covered=0.5, iterations=2, scale_range=(low, high)
        )
        assert ((scales == low) | (scales == high)).all()


def test_clouds_in_one_place_have_no_alignment():
    place = np.zeros((10, 3))  # elsewhere, means of them differ from them by a rounding
    start = [(np.eye(3), 1.0, np.zeros(3))]
    for part, whole in ((place, WHOLE), (PART, place), (place, place)):
        *_, costs = improved(part, whole, start, covered=0.05, iterations=2, scale_range=(0.1, 9))
        assert np.isinf(costs[0])


def test_one_rotation_is_a_rotation_and_none_are_none():
    (turn,) = even_rotations(1)
    assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-15)
    assert even_rotations(0).shape == (0, 3, 3)
