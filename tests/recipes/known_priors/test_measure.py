"""Errors of completions whose right answer is known."""

import torch

from gscomplete.splats import concatenate
from gscomplete.views import ViewDistribution
from recipes.known_priors.measure import errors_of
from recipes.known_priors.objects import KnownObject, believed
from tests.builders.objects import ball, moved

TRUTH = ball(1500).with_sh_degree(0)
HIDDEN = TRUTH.means[:, 0] < 0
ITEM = KnownObject(
    "ball", "half", TRUTH.select(~HIDDEN), TRUTH, HIDDEN, ViewDistribution(0.0, 10.0)
)


def test_the_missing_half_itself_has_no_errors():
    errors = errors_of(ITEM, TRUTH.select(HIDDEN), (TRUTH,))
    assert errors["silhouette_iou"] > 0.999
    assert errors["fog"] == 0.0
    assert errors["hidden_color_psnr_db"] > 60


def test_fog_is_what_stands_off_the_object_and_not_what_lies_in_it():
    missing = TRUTH.select(HIDDEN)
    far = moved(missing.select(torch.arange(40)), (0.0, 0.0, 0.9))
    clean, hazy = (
        errors_of(ITEM, splats, (TRUTH,)) for splats in (missing, concatenate([missing, far]))
    )
    assert clean["fog"] == 0.0
    assert hazy["fog"] > 0.005


def test_any_of_several_plausible_objects_is_right():
    objects = believed(ITEM, "plausible")
    assert len(objects) == 3
    for splats in objects:
        errors = errors_of(ITEM, splats.select(HIDDEN), objects)
        assert errors["silhouette_iou"] > 0.999


def test_the_biased_object_differs_where_v_sees_the_input():
    (other,) = believed(ITEM, "biased")
    errors = errors_of(ITEM, other, (other,))
    assert errors["e_color_v"] > 0.01
