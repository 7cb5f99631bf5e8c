"""Views from which the truth leaves a part in sight."""

import dataclasses

from gscomplete.framing.decide import FramingRequest, decide_framing
from gscomplete.splats import concatenate
from gscomplete.views import ViewDistribution
from splatcomplete_data.framing import seen_past_truth
from tests.builders.objects import half_cylinder


def test_the_input_view_is_one_from_which_the_truth_leaves_the_part_in_sight():
    part, rest = half_cylinder(75.0), half_cylinder(255.0)
    truth = concatenate([part, rest])
    by_part = decide_framing(part, FramingRequest(), truth)
    hidden = dataclasses.replace(by_part, views=ViewDistribution(255.0, 15.0))
    found = seen_past_truth(hidden, part, truth)
    assert abs((found.views.azimuth_deg - 75.0 + 180) % 360 - 180) <= 30
    assert "the complete object hides P" in found.notes[-1]
    assert seen_past_truth(hidden, part, None) is hidden
    seen = dataclasses.replace(by_part, views=ViewDistribution(75.0, 15.0))
    assert seen_past_truth(seen, part, truth) is seen
