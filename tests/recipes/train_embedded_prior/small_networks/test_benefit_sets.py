import numpy as np
import pytest

from gscomplete.shape.benefit import FEATURES
from gscomplete.shape.planes.answer_scorer import answer_features, packaged_answer_scorer
from gscomplete.shape.voxels import shadows
from recipes.real_objects.load import RealObject
from recipes.train_embedded_prior.small_networks.answer_sets import (
    LEVEL,
    asked_part,
    shadow_ious,
)
from recipes.train_embedded_prior.small_networks.benefit_sets import benefit_of, benefit_sets_of
from recipes.train_embedded_prior.small_networks.object_tasks import (
    ObjectTask,
    framed_item,
    train_entries,
)
from tests.builders.mesh_pack import write_pack
from tests.builders.objects import ball


def test_the_gain_is_that_of_the_answer_put_first_over_p():
    whole = ball(3000)
    part = whole.select(whole.means[:, 2] < 0.2)  # the network is asked: it is open above
    asked = asked_part(framed_item(RealObject("ball", "a ball", "Z", part, whole, "box")))
    assert asked is not None
    features, gain = benefit_of(asked)
    assert features.shape == (len(FEATURES),)
    assert np.isfinite(features).all()
    first = int(packaged_answer_scorer()(answer_features(asked.answers)).argmax())
    own = asked.answers.partial > 0
    both = zip(shadows(own[None]), shadows((asked.solid | own)[None]), strict=True)
    of_partial = np.mean([float(part.sum() / whole.sum()) for part, whole in both])
    true = float(shadow_ious(asked.answers, asked.solid, LEVEL)[first])
    assert gain == pytest.approx(true - of_partial, abs=1e-6)


def test_sets_are_a_function_of_seed_and_object(tmp_path):
    pack = write_pack(tmp_path)
    entry = train_entries(pack, 3, 100)[0]
    made, again = (benefit_sets_of(ObjectTask(pack, entry, 3)) for _ in range(2))
    assert made.features.shape == (len(made), len(FEATURES))
    np.testing.assert_array_equal(made.features, again.features)
    np.testing.assert_array_equal(made.gains, again.gains)
    assert set(made.complete.tolist()) <= {0.0, 1.0}
    assert (np.abs(made.gains) <= 1).all()
