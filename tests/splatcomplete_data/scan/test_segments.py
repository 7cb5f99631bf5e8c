"""Objects that touch are separated at concave contacts; convex edges hold an object together."""

import numpy as np
import pytest

from splatcomplete_data.cuts.boxes import CropBox
from splatcomplete_data.scan.clean import CleanSettings, Surroundings
from splatcomplete_data.scan.make import PartSettings, make_part
from splatcomplete_data.scan.segments import VOTES, beyond_boxes, object_at, segment
from tests.builders.table_top import EYE, SPACING, box, table_top

FRONT = box((-0.1, -0.05), (0.2, 0.12, 0.12))
BEHIND = box((-0.05, 0.11), (0.24, 0.2, 0.3), 0)
PAIR = table_top([FRONT, BEHIND])


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("label", [1, 2])
def test_a_seed_point_separates_touching_boxes(label, known):
    own = PAIR.points[PAIR.labels == label]
    seed = own[np.square(own - np.median(own, axis=0)).sum(axis=1).argmin()]
    settings = PartSettings((), CleanSettings(seed_point=tuple(seed)), level="always")
    around = Surroundings(tuple(EYE) if known else None)
    part = make_part(PAIR, settings, "scene", around)
    kept = part.cloud.labels[part.reason < 0]
    assert (kept == label).mean() > 0.95
    # the lowest rows of the sides lie within the table's thickness, a spacing at least
    assert (kept == label).sum() > 0.85 * len(own)


def test_a_box_leaves_out_the_neighbour_that_goes_on_beyond():
    own = PAIR.points[PAIR.labels == 1]
    low, high = own.min(axis=0) - 0.02, own.max(axis=0) + 0.02
    crop = CropBox(tuple((low + high) / 2), tuple((high - low) / 2))
    around = Surroundings(tuple(EYE))
    part = make_part(PAIR, PartSettings((crop,), CleanSettings(clusters=0)), "scene", around)
    kept = part.cloud.labels[part.reason < 0]
    assert (part.cloud.labels == 2).sum() > 200
    assert (kept == 1).mean() > 0.97
    assert (kept == 1).sum() > 0.85 * len(own)


def test_a_box_leaves_out_a_large_neighbour_that_it_cuts_and_keeps_a_part_that_it_cuts():
    """The neighbour lies three quarters inside the box; so does a part as small as a handle."""
    own = box((0.0, 0.0), (0.3, 0.2, 0.2))
    standing = table_top(
        [own, box((0.3, 0.0), (0.12, 0.2, 0.2)), box((-0.3, 0), (0.06, 0.06, 0.06))]
    )
    standing = standing.select(np.flatnonzero(standing.labels > 0))
    inside = np.abs(standing.points[:, 0]) < 0.315
    beyond = beyond_boxes(standing.points, standing.colors, inside, SPACING, viewpoint=EYE)
    for label in (2, 3):
        assert 0.5 < inside[standing.labels == label].mean() < 0.9
    assert not beyond[standing.labels == 1].any()
    assert beyond[standing.labels == 2].all()
    assert not beyond[standing.labels == 3].any()


def test_numbers_do_not_depend_on_the_order_of_points():
    standing = PAIR.select(np.flatnonzero(PAIR.labels > 0))
    shuffled = np.random.default_rng(0).permutation(len(standing))
    for cloud, order in (
        (standing, np.arange(len(standing))),
        (standing.select(shuffled), shuffled),
    ):
        labels = segment(cloud.points, cloud.colors, SPACING, VOTES[1], viewpoint=EYE)
        assert labels.min() == 0
        back = np.empty_like(labels)
        back[order] = labels
        if cloud is standing:
            first = back
    assert (first == back).mean() > 0.99


def test_one_point_is_an_object():
    mask = object_at(np.zeros((1, 3)), np.zeros((1, 3)), np.ones(3), 1.0)
    assert mask.tolist() == [True]
