from pathlib import Path

import numpy as np

from gscomplete.splats.strays import FEATURES
from recipes.train_embedded_prior.small_networks.object_tasks import ObjectTask, train_entries
from recipes.train_embedded_prior.small_networks.train_stray_scorer import (
    StrayScorerConfig,
    StraySets,
    fit,
    stray_sets_of,
    told,
)
from tests.builders.mesh_pack import write_pack

CONFIG = StrayScorerConfig(Path("unused"), epochs=20, batch_rows=64, width=16)


def simple_sets(count: int) -> StraySets:
    """One feature tells which splats are strays."""
    rng = np.random.default_rng(count)
    features = rng.normal(size=(count, len(FEATURES))).astype(np.float32)
    return StraySets(
        features, (features[:, 2] > 0.5).astype(np.float32), np.ones(count, np.float32)
    )


def test_a_scorer_learns_which_splats_are_strays():
    scorer, sets = fit(CONFIG, simple_sets(2000)), simple_sets(300)
    clear = np.abs(sets.features[:, 2] - 0.5) > 0.2
    right = (scorer(sets.features) > 0) == (sets.is_stray > 0)
    assert right[clear].mean() > 0.95
    assert fit(CONFIG, simple_sets(2000)).digest() == scorer.digest()


def test_sets_are_a_function_of_the_object(tmp_path):
    pack = write_pack(tmp_path)
    entry = train_entries(pack, 3, 100)[0]
    made, again = (stray_sets_of(ObjectTask(pack, entry, 3)) for _ in range(2))
    assert made.features.shape == (len(made), len(FEATURES))
    assert len(made) > 100
    assert np.isfinite(made.features).all()
    assert set(made.is_stray.tolist()) == {0.0, 1.0}
    assert (made.stands_for >= 1).all()
    np.testing.assert_array_equal(made.features, again.features)
    np.testing.assert_array_equal(made.is_stray, again.is_stray)


def test_what_is_told_counts_every_splat_for_what_it_stands_for():
    features = np.zeros((4, len(FEATURES)), np.float32)
    features[:3, 0] = 9  # marked: two of the strays, and surface
    sets = StraySets(features, np.array([1, 1, 0, 0], "f4"), np.array([1, 2, 1, 9], "f4"))
    text = told("here", lambda rows: rows[:, 0], sets)
    assert text == (
        "here, 4 splats that stand out: 100.0% of the strays are found, "
        "10.00% of the surface passes for strays"
    )
