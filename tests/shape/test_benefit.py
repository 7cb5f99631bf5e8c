import numpy as np
import pytest
import torch

from gscomplete.shape.benefit import (
    FEATURES,
    LEFT_BELOW,
    OF_ANSWERS,
    features_of_answers,
    is_better_left,
    packaged_benefit_scorer,
)
from gscomplete.shape.planes.answer_scorer import Answers
from tests.builders.threads import each_thread_count


def answers_of(filled: np.ndarray, partial: np.ndarray) -> Answers:
    shares = torch.from_numpy(filled.astype(np.float32))
    return Answers((), torch.empty(0), shares, torch.from_numpy(partial).float(), 1.0, False)


def lines_of(cells: np.ndarray) -> list[set[tuple[int, int]]]:
    """Return the lines along x, y, z and the level diagonals that cells lie on."""
    x, y, z = np.argwhere(cells).T
    return [
        set(zip(a.tolist(), b.tolist(), strict=True))
        for a, b in ((y, z), (x, z), (x, y), (x - y, z), (x + y, z))
    ]


def slow_new_shares(filled: np.ndarray, partial: np.ndarray) -> tuple[float, float, list[float]]:
    """Return new shares of surface and volume, and of each shadow, cell by cell."""
    padded = np.pad(partial, 1)
    cells = [tuple(c) for c in np.argwhere(filled)]
    near = {c for c in cells if padded[c[0] : c[0] + 3, c[1] : c[1] + 3, c[2] : c[2] + 3].any()}
    around = np.pad(filled, 1)
    on_surface = [
        c for c in cells if not around[c[0] : c[0] + 3, c[1] : c[1] + 3, c[2] : c[2] + 3].all()
    ]
    surface = np.mean([c not in near for c in on_surface])
    volume = np.mean([c not in near for c in cells])
    both = zip(lines_of(filled | partial), lines_of(partial), strict=True)
    return surface, volume, [1 - len(own) / len(all_of) for all_of, own in both]


def test_numbers_of_answers_are_those_counted_cell_by_cell():
    rng = np.random.default_rng(0)
    solid = np.zeros((3, 12, 12, 12))
    solid[:, 3:9, 2:10, 3:8] = 1
    filled = solid * rng.choice([0.9, 0.4, 0.1], size=solid.shape, p=[0.8, 0.15, 0.05])
    partial = (solid[0] > 0) & (np.indices((12, 12, 12))[1] < 5)
    found = dict(
        zip(OF_ANSWERS, features_of_answers(answers_of(filled, partial), 1).tolist(), strict=True)
    )
    sure = [slow_new_shares(answer > 0.5, partial) for answer in filled]
    some = slow_new_shares(filled[1] > 0.35, partial)
    expected = {
        "surface": sure[1][0],
        "surface_mean": np.mean([s[0] for s in sure]),
        "surface_least": min(s[0] for s in sure),
        "volume": sure[1][1],
        "volume_mean": np.mean([s[1] for s in sure]),
        "volume_least": min(s[1] for s in sure),
        "shadow": np.mean(sure[1][2]),
        "shadow_most": max(sure[1][2]),
        "shadow_mean": np.mean([s[2] for s in sure]),
        "shadow_least": min(np.mean(s[2]) for s in sure),
        "surface_possible": some[0],
        "shadow_possible": np.mean(some[2]),
    }
    assert found == pytest.approx(expected, abs=1e-6)  # sums of counts, in float32


def test_nothing_is_new_where_answers_are_empty():
    partial = np.zeros((12, 12, 12), bool)
    partial[4:7, 4:7, 4:7] = True
    found = features_of_answers(answers_of(np.zeros((2, 12, 12, 12)), partial), 0)
    np.testing.assert_array_equal(found, 0)


def test_the_packaged_scorer_leaves_what_hides_its_inside_and_gains_nothing():
    """Little exposed, next to nothing new; against half of the surface exposed and new."""
    closed = np.array([np.log(0.006), np.log(0.003), 0.5, 0, 0, 0, 0], np.float32)
    open_ = np.array([np.log(0.4), np.log(0.4), 0.5, 1, 0.7, 1, 0.05], np.float32)
    nothing = np.full(len(OF_ANSWERS), 0.01, np.float32)
    half_of_all = np.full(len(OF_ANSWERS), 0.45, np.float32)
    assert is_better_left(closed, nothing)
    assert not is_better_left(open_, half_of_all)


def test_the_packaged_scorer_reads_all_features():
    scorer = packaged_benefit_scorer()
    assert scorer.tensors["center"].shape == (len(FEATURES),)
    assert LEFT_BELOW < 0  # only where the scorer is sure


def test_numbers_do_not_depend_on_threads():
    rng = np.random.default_rng(1)
    answers = answers_of(rng.random((9, 48, 48, 48)), rng.random((48, 48, 48)) > 0.99)
    one, *others = (features_of_answers(answers, 2) for _ in each_thread_count())
    for other in others:
        np.testing.assert_array_equal(one, other)
