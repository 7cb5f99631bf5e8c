import dataclasses
import functools

import numpy as np
import torch

from gscomplete.shape.outline.scorer import FEATURES
from gscomplete.splats import concatenate
from gscomplete.views import ViewDistribution
from recipes.real_objects.captured import captured_part
from recipes.train_embedded_prior.small_networks import object_tasks
from recipes.train_embedded_prior.small_networks.object_tasks import ObjectTask, train_entries
from recipes.train_embedded_prior.small_networks.outline_sets import (
    CAPTURE,
    KINDS,
    VIEWS,
    capture_sets_of,
    cut_sets_of,
    outline_sets_of,
    outline_shares,
)
from recipes.train_embedded_prior.small_networks.train_outline_scorer import OutlineScorerConfig
from tests.builders.mesh_pack import write_pack
from tests.builders.objects import ball

LEVEL = ViewDistribution(0.0, 0.0)


def test_of_a_complete_object_all_outlines_are_whole():
    points = ball(6000).means.numpy()
    assert outline_shares(points, points, LEVEL).tolist() == [1.0] * VIEWS


def test_half_a_ball_has_half_an_outline_from_its_sides_and_all_of_it_from_its_front():
    points = ball(20_000).means.numpy()
    shares = outline_shares(points[points[:, 0] > 0], points, LEVEL)[:24]  # level, from +x on
    assert shares[0] == shares[12] == 1.0
    assert 0.5 < shares[6] < 0.65  # an outline is two pixels wider than its points
    assert (np.diff(shares[:7]) <= 0).all()


def test_sets_are_a_function_of_seed_and_object(tmp_path):
    pack = write_pack(tmp_path)
    entry = train_entries(pack, 3, 100)[0]
    made, again = (outline_sets_of(ObjectTask(pack, entry, 3)) for _ in range(2))
    assert made.features.shape == (len(made), VIEWS, len(FEATURES))
    assert made.shares.shape == (len(made), VIEWS)
    np.testing.assert_array_equal(made.features, again.features)
    np.testing.assert_array_equal(made.shares, again.shares)
    kinds = [KINDS[int(k)] for k in made.kinds]
    assert kinds[:2] == ["scan", "arc"]
    assert kinds[-1] == "wide"
    cut = cut_sets_of(ObjectTask(pack, entry, 3))
    assert KINDS[int(cut.kinds[0])] == "box"
    assert len(cut) == 2
    other = outline_sets_of(ObjectTask(pack, entry, 4))
    assert other.shares.tolist() != made.shares.tolist()


def config_in(folder, count: int) -> OutlineScorerConfig:
    return OutlineScorerConfig(write_pack(folder), captures=count, keep=folder / "kept")


def test_a_capture_is_trained_once_and_beside_its_object(tmp_path, monkeypatch):
    short = functools.partial(captured_part, steps=2)
    monkeypatch.setattr(object_tasks, "captured_part", short)
    tasks = config_in(tmp_path, 2).capture_tasks()
    assert len({task.of.entry.id for task in tasks}) == 2
    turned, made = tasks[0].captured()
    monkeypatch.setattr(object_tasks, "captured_part", None)
    again, kept = tasks[0].captured()
    assert torch.equal(made.means, kept.means)
    assert turned.rng.random() == again.rng.random()  # whether it was trained or read
    (low, high), bounds = made.bounds(), turned.complete.bounds()
    assert bool((low > bounds[0] - 0.03).all() and (high < bounds[1] + 0.03).all())


def test_outlines_of_a_capture_are_those_of_what_is_heeded(tmp_path, monkeypatch):
    """A capture that is a whole object with strays has whole outlines."""

    def whole_with_strays(complete, _):
        few = complete.select(torch.arange(0, len(complete), 100))
        middle = complete.means.mean(dim=0)
        moved = few.means + 0.3 * torch.nn.functional.normalize(few.means - middle, dim=1)
        return concatenate([complete, dataclasses.replace(few, means=moved)])

    width = FEATURES.index("width")
    found = []
    for captured in (whole_with_strays, lambda complete, _: complete):
        monkeypatch.setattr(object_tasks, "captured_part", captured)
        task = config_in(tmp_path / str(len(found)), 1).capture_tasks()[0]
        made = capture_sets_of(task)
        assert [KINDS[int(k)] for k in made.kinds] == [CAPTURE]
        assert made.shares[0].min() > 0.97
        found.append(made.features[0, :, width])
    np.testing.assert_allclose(*found, rtol=0.05)  # with strays .3 wider
