import dataclasses
import math

import numpy as np
import pytest
import torch

from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.planes.answer_scorer import (
    FEATURES,
    OF_ANSWER,
    Answers,
    answer_features,
    missing_share,
    packaged_answer_scorer,
    sureness,
    symmetry_scores_of_answers,
)
from gscomplete.shape.symmetry import mirror
from gscomplete.shape.voxels import CELLS, HALF_SIDE, cell_centers
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half
from tests.builders.shape_network import mirrors
from tests.builders.threads import each_thread_count

LOOK = voxelize_partial(half(ball()), ViewDistribution(0.0, 10.0))
PLANES = (mirror(0.0, 0.0, 0.7), mirror(1.2, 0.05, 0.2), mirror(0.4, 0.6, 0.0))


def answers_about_half_a_ball(noise: float = 0.0) -> Answers:
    """The first copy completes the ball, the others are elsewhere; then comes no copy."""
    copies = [torch.from_numpy(LOOK.with_copies((p,) * 3).volumes[1, 0]) for p in PLANES]
    partial = torch.from_numpy(LOOK.volume[0])
    own = (partial > 0).float()
    filled = torch.stack([torch.maximum(own, (copy > 0) * 0.9) for copy in copies] + [own])
    drawn = torch.rand(filled.shape, generator=torch.Generator().manual_seed(0))
    filled = filled + noise * (drawn - filled)
    return Answers(PLANES, torch.stack(copies), filled, partial, 0.8, False)


def slow_features(answers: Answers, index: int) -> list[float]:
    """What is known of one answer in float64, cell by cell where it is short."""
    filled = answers.filled.double().numpy()
    partial = answers.partial.numpy() > 0
    own = np.zeros_like(partial)
    for x, y, z in np.argwhere(partial):
        own[max(x - 1, 0) : x + 2, max(y - 1, 0) : y + 2, max(z - 1, 0) : z + 2] = True
    this, mean = filled[index], filled[: len(answers.planes)].mean(axis=0)
    possible = this > 0.1
    sure = np.abs(2 * this - 1)[possible].mean()
    cells = math.log((this > 0.35).sum() + 1.0) - math.log(partial.sum() + 1.0)
    agreement = (this * mean).sum() / (this + mean - this * mean).sum()
    deviation = np.abs(this - mean).sum() / (mean.sum() + 1)
    if index == len(answers.planes):
        return [sure, 0.0, math.log(1e-4), cells, agreement, deviation, 1.0, 0, 0, 0, 0, 0]
    plane = answers.planes[index]
    copy = answers.copies[index].numpy() > 0
    new = copy & ~own
    points = cell_centers(CELLS)[partial].astype(np.float64)
    images = points @ plane.matrix.astype(np.float64).T + plane.shift
    eigenvalues, vectors = np.linalg.eigh(plane.matrix.astype(np.float64))
    normal = vectors[:, eigenvalues.argmin()]
    across, images_across = points @ normal, images @ normal
    middle = plane.shift.astype(np.float64) @ normal / 2
    side = (across > middle).mean()
    both = np.concatenate([across, images_across])
    score = symmetry_scores_of_answers(answers.to_copies(), answers.copies, answers.partial)
    return [
        sure,
        float(score[index]),
        math.log(plane.score + 1e-4),
        cells,
        agreement,
        deviation,
        0.0,
        1 - new.sum() / copy.sum(),
        (np.abs(images) > HALF_SIDE).any(axis=1).mean(),
        min(side, 1 - side),
        np.ptp(both) / np.ptp(across) - 1,
        this[new].mean() if new.any() else 1.0,
    ]


def test_features_are_those_of_their_definitions():
    answers = answers_about_half_a_ball(noise=0.2)
    found = answer_features(answers)
    assert found.shape == (4, len(FEATURES))
    of_answer = np.array([slow_features(answers, k) for k in range(4)])
    part = [missing_share(answers.to_copies(), answers.partial), 0.8, 0.0]
    part.append(math.log(float((answers.partial > 0).sum()) + 1))
    expected = np.concatenate(
        [
            of_answer,
            of_answer - of_answer.mean(axis=0),
            of_answer - of_answer[:3].max(axis=0),
            np.tile(part, (4, 1)),
        ],
        axis=1,
    )
    # float32 sums over 110,592 cells
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


def test_the_answer_to_no_copy_may_be_missing():
    every = answers_about_half_a_ball()
    cut = Answers(PLANES, every.copies, every.filled[:3], every.partial, 0.8, True)
    found = answer_features(cut)
    assert found.shape == (3, len(FEATURES))
    assert (found[:, OF_ANSWER.index("no_copy")] == 0).all()
    assert (found[:, FEATURES.index("ends_in_plane")] == 1).all()


def test_scores_do_not_depend_on_the_number_of_threads():
    few = answers_about_half_a_ball(noise=0.2)
    to_copies = few.to_copies()
    answers = dataclasses.replace(  # as many as a run asks for
        few,
        planes=few.planes * 2 + few.planes[:2],
        copies=few.copies[[0, 1, 2, 0, 1, 2, 0, 1]],
        filled=torch.cat([to_copies, 0.99 * to_copies, 0.97 * to_copies[:2], few.filled[3:]]),
    )
    one, *others = (answer_features(answers) for _ in each_thread_count())
    for other in others:
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("content", [0.0, 1.0])
def test_extremes_give_finite_scores(content):
    """Empty and full grids, copies of nothing and of everything."""
    full = torch.full((CELLS,) * 3, content)
    for partial in (full, torch.zeros_like(full)):
        answers = Answers(
            PLANES, full.expand(3, -1, -1, -1), full.expand(4, -1, -1, -1), partial, 1.0, False
        )
        found = answer_features(answers)
        assert np.isfinite(found).all()
        assert np.isfinite(packaged_answer_scorer()(found)).all()


def test_a_sure_answer_to_the_right_copy_is_preferred_to_doubtful_ones_to_others():
    answers = answers_about_half_a_ball()
    filled = answers.filled.clone()
    doubted = filled[1:3] > answers.partial
    filled[1:3] = torch.where(doubted, 0.45, filled[1:3])
    scores = packaged_answer_scorer()(answer_features(dataclasses.replace(answers, filled=filled)))
    assert scores[0] > scores[1:3].max()


def test_a_copy_the_answer_fills_scores_above_one_it_leaves_empty():
    seen = LOOK.with_copies(mirrors())
    partial, across, along = (torch.from_numpy(seen.volumes[k, 0]) for k in range(3))
    complete = ((partial > 0) | (across > 0)).float()
    alone = (partial > 0).float()
    answers = torch.stack([complete, complete, alone])
    filled, useless, refused = symmetry_scores_of_answers(
        answers, torch.stack([across, along, across]), partial
    ).tolist()
    assert filled > 0.95
    assert abs(useless) < 0.1  # it shows nothing new
    assert refused < -0.2


def test_an_answer_that_adds_next_to_nothing_does_not_win():
    seen = LOOK.with_copies(mirrors())
    partial, across, along = (torch.from_numpy(seen.volumes[k, 0]) for k in range(3))
    complete = ((partial > 0) | (across > 0)).float()
    little = (partial > 0).float()
    free = (along > 0) & (torch.nn.functional.max_pool3d(partial[None], 3, 1, 1)[0] <= 0)
    little[free] = 1.0  # the few new cells of the copy are all filled
    symmetry_scores = symmetry_scores_of_answers(
        torch.stack([complete, little]), torch.stack([across, along]), partial
    )
    assert float(symmetry_scores[0]) > float(symmetry_scores[1]) + 0.5


def test_answers_are_as_sure_as_they_are_far_from_one_half():
    filled = torch.zeros(3, 4, 4, 4)
    filled[0, 0] = 1.0
    filled[1, 0] = 0.75
    sure = sureness(filled).tolist()
    assert sure == [1.0, 0.5, 0.0]
    filled[0, 1] = 0.05  # as good as empty
    assert sureness(filled).tolist() == sure


def test_what_is_missing_is_the_surface_beyond_p():
    seen = LOOK.with_copies(mirrors())
    partial, across = (torch.from_numpy(seen.volumes[k, 0]) for k in (0, 1))
    whole = ((partial > 0) | (across > 0)).float()[None]
    # half of a ball, but for the cells beside the other
    assert 0.3 < missing_share(whole, partial) < 0.5
    assert missing_share((partial > 0).float()[None], partial) == 0
    assert missing_share(torch.zeros_like(whole), partial) == 0
