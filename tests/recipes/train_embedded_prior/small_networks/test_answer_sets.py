import numpy as np
import torch

from gscomplete.shape.planes.answer_scorer import FEATURES, OF_ANSWER, Answers
from recipes.train_embedded_prior.small_networks.answer_sets import (
    ANSWERS,
    answer_sets_of,
    shadow_ious,
)
from recipes.train_embedded_prior.small_networks.object_tasks import ObjectTask, train_entries
from tests.builders.mesh_pack import write_pack


def slow_shadow_iou(filled: np.ndarray, true: np.ndarray) -> float:
    """Shadows as sets of the lines that filled cells lie on."""
    x, y, z = np.indices(filled.shape)
    scores = []
    for line in ((y, z), (x, z), (x, y), (x - y, z), (x + y, z)):
        a, b = (set(zip(*(p[cells] for p in line), strict=True)) for cells in (filled, true))
        scores.append(len(a & b) / len(a | b))
    return float(np.mean(scores))


def test_true_scores_are_overlaps_of_shadows():
    rng = np.random.default_rng(0)
    true, partial = rng.random((2, 12, 12, 12)) > 0.995
    filled = rng.random((3, 12, 12, 12)).astype(np.float32) ** 40
    answers = Answers(
        (), torch.empty(0), torch.from_numpy(filled), torch.from_numpy(partial).float(), 1.0, False
    )
    found = shadow_ious(answers, torch.from_numpy(true), 0.5)
    level = 1 / (1 + np.exp(-0.5))
    expected = [slow_shadow_iou((f > level) | partial, true | partial) for f in filled]
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-6)


def test_sets_are_a_function_of_seed_and_object(tmp_path):
    pack = write_pack(tmp_path)
    entry = train_entries(pack, 3, 100)[0]
    made, again = (answer_sets_of(ObjectTask(pack, entry, 3)) for _ in range(2))
    assert made.features.shape == (len(made), ANSWERS, len(FEATURES))
    np.testing.assert_array_equal(made.features, again.features)
    np.testing.assert_array_equal(made.true_scores, again.true_scores)
    asked = ~np.isnan(made.true_scores)
    assert (made.true_scores[asked] <= 1).all()
    assert (made.features[~asked] == 0).all()
    none = made.features[..., OF_ANSWER.index("no_copy")] == 1
    assert (none.sum(axis=1) == (asked.sum(axis=1) == ANSWERS)).all()
