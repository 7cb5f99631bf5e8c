import numpy as np

from gscomplete.shape.outline.scorer import FEATURES
from gscomplete.views import ViewDistribution
from recipes.train_embedded_prior.small_networks.object_tasks import ObjectTask, train_entries
from recipes.train_embedded_prior.small_networks.outline_sets import (
    KINDS,
    VIEWS,
    cut_sets_of,
    outline_sets_of,
    outline_shares,
)
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
