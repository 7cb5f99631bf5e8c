"""Planes that bear an object are told from the object's own faces."""

import numpy as np
import pytest

from splatcomplete_data.cuts.boxes import CropBox
from splatcomplete_data.scan.clean import CleanSettings, Surroundings
from splatcomplete_data.scan.make import PartSettings, make_part
from splatcomplete_data.scan.support import PlaneSettings, find_support_planes
from tests.builders.table_top import EYE, SPACING, box, table_top


def boxed(points, margin=0.012):
    """Return a box around points."""
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    return CropBox(tuple((low + high) / 2), tuple((high - low) / 2))


@pytest.mark.parametrize("eye", [None, EYE])
def test_the_table_goes_and_not_the_larger_front_of_the_box(eye):
    """Within the box, the object's front has three times the points of the table."""
    cloud = table_top([box((0, 0), (0.5, 0.1, 0.4))])
    own = cloud.points[cloud.labels == 1]
    crop = boxed(own)
    inside = crop.contains(cloud.points)
    assert (cloud.labels[inside] == 1).sum() > 3 * (cloud.labels[inside] == 0).sum()
    known = Surroundings(None if eye is None else tuple(eye))
    settings = PartSettings((crop,), CleanSettings(clusters=0), level="always")
    part = make_part(cloud, settings, "scene", known)
    kept = part.cloud.labels[part.reason < 0]
    assert (kept == 1).mean() > 0.99
    assert (kept == 1).sum() > 0.93 * len(own)
    assert part.turn.rotation[2].numpy() @ [0, 0, 1] > 0.999
    assert float(part.splats.means[:, 2].max()) == pytest.approx(0.4, abs=0.01)
    assert not any("doubtful" in warning for warning in part.warnings)


def test_an_object_alone_keeps_its_faces(monkeypatch):
    cloud = table_top([box((0, 0), (0.5, 0.3, 0.4), 30)])
    own = cloud.select(np.flatnonzero(cloud.labels == 1))
    everything = np.ones(len(own), np.bool_)
    with monkeypatch.context() as small:
        small.setattr("splatcomplete_data.scan.support._LEAST_SHARE", 0.02)
        accepted, refused = find_support_planes(
            own.points, everything, 1, SPACING, PlaneSettings(), viewpoint=EYE
        )
    assert accepted == []
    assert len(refused) == 3
    part = make_part(own, PartSettings(cleaning=CleanSettings()), "scene", Surroundings(tuple(EYE)))
    assert len(part.splats) > 0.95 * len(own)
    assert any("no plane was found" in warning for warning in part.warnings)


def test_level_planes_come_before_larger_walls():
    cloud = table_top([box((0, 0), (0.1, 0.1, 0.2))])
    wall = np.random.default_rng(1).uniform([-0.6, 0.6, 0], [0.6, 0.601, 2.0], (80_000, 3))
    points = np.concatenate([cloud.points, wall])
    everything = np.ones(len(points), np.bool_)
    up = np.array([0.0, 0.0, 1.0])
    found, refused = find_support_planes(
        points, everything, 2, SPACING, PlaneSettings(), up=up, viewpoint=EYE
    )
    assert abs(refused[0].plane[1]) > 0.99  # the wall is larger, and the table stands at its foot
    assert refused[0].inside.sum() > 2 * found[0].inside.sum()
    assert found[0].angle_deg == pytest.approx(0, abs=1)
    assert (found[0].heights(wall[:1]) > 0).all()


def test_losses_and_turns_upside_down_are_told():
    cloud = table_top([box((0, 0), (0.1, 0.1, 0.05))])
    crop = CropBox((0, 0, 0.05), (0.2, 0.2, 0.1))
    settings = PartSettings((crop,), CleanSettings(clusters=0), level="always")
    below = Surroundings((0.0, 0.0, -3.0), (0.0, 0.0, 1.0))
    part = make_part(cloud, settings, "scene", below)
    assert any(w.startswith("doubtful") and "points (" in w for w in part.warnings)
    assert any("lie below the plane" in warning for warning in part.warnings)
    assert any("by 180 degrees, upside down" in warning for warning in part.warnings)
