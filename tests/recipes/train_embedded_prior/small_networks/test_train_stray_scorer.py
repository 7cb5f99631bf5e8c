import dataclasses
from pathlib import Path

import numpy as np
import torch

from gscomplete.splats import concatenate
from gscomplete.splats.strays import FEATURES
from recipes.train_embedded_prior.small_networks import object_tasks
from recipes.train_embedded_prior.small_networks.array_sets import joined
from recipes.train_embedded_prior.small_networks.object_tasks import (
    CaptureTask,
    ObjectTask,
    train_entries,
)
from recipes.train_embedded_prior.small_networks.train_stray_scorer import (
    StrayScorerConfig,
    StraySets,
    captured_sets_of,
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
    is_stray = (features[:, 2] > 0.5).astype(np.float32)
    return StraySets(features, is_stray, *np.stack([np.ones(count), np.zeros(count)]).astype("f4"))


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


def test_splats_of_a_capture_are_surface_strays_or_neither(tmp_path, monkeypatch):
    def captured(complete, rng):
        """Return the object, splats that lie off it, and some that lie nearly on it."""
        off, nearly = (complete.select(torch.arange(0, len(complete), 3)) for _ in range(2))
        moved = [
            dataclasses.replace(part, means=part.means * (1 + away), scales=2 * part.scales)
            for part, away in ((off, 0.3), (nearly, 0.03))
        ]
        return concatenate([complete, *moved])

    monkeypatch.setattr(object_tasks, "captured_part", captured)
    pack = write_pack(tmp_path)
    task = ObjectTask(pack, train_entries(pack, 3, 100)[0], 3)
    made = captured_sets_of(CaptureTask(task, tmp_path / "captures"))
    assert made.is_captured.all()
    assert 0.2 < made.is_stray.mean() <= 1
    assert made.features[made.is_stray > 0, FEATURES.index("size")].min() > 0.5


def test_what_is_told_counts_every_splat_for_what_it_stands_for():
    features = np.zeros((4, len(FEATURES)), np.float32)
    features[:3, 0] = 9  # marked: two of the strays, and surface
    labels, counts = np.array([1, 1, 0, 0], "f4"), np.array([1, 2, 1, 9], "f4")
    sets = StraySets(features, labels, counts, np.zeros(4, "f4"))
    line = (
        "here, 4 splats of parts that stand out: 100.0% of the strays are found, "
        "10.00% of the surface passes for strays"
    )
    assert told("here", lambda rows: rows[:, 0], sets) == line
    captured = dataclasses.replace(sets, is_captured=np.ones(4, "f4"))
    both = told("here", lambda rows: rows[:, 0], joined([sets, captured]))
    assert both == line + "\n" + line.replace("parts", "captures")


def test_few_captures_weigh_much():
    """40 captured splats whose labels are opposite make scores less certain."""
    parts, few = simple_sets(2000), simple_sets(40)
    opposite = dataclasses.replace(
        few, is_stray=1 - few.is_stray, is_captured=np.ones(40, np.float32)
    )
    alone, mixed = fit(CONFIG, parts), fit(CONFIG, joined([parts, opposite]))
    scores = [np.abs(scorer(parts.features)).mean() for scorer in (alone, mixed)]
    assert scores[1] < 0.7 * scores[0]
