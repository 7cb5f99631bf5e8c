import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from gscomplete.shape.network import ShapeOutput
from gscomplete.shape.partial_voxels import ShapeInputs
from gscomplete.shape.surface import depth as surface_depth
from gscomplete.shape.surface.continuation import CROSSINGS, OrientedPoints, crossings
from gscomplete.shape.surface.depth import (
    DEPTH_BINS,
    DEPTHS,
    FEATURES,
    depth_features,
    median_depth,
    softmax,
    surface_depths,
)
from gscomplete.shape.symmetry import COPIES, SOURCES
from gscomplete.shape.voxels import CELL_SIDE, CELLS, COARSE_CELLS, cell_centers
from tests.builders.shape_network import mirrors
from tests.builders.threads import each_thread_count

CENTERS = torch.from_numpy(cell_centers(CELLS)).float()
SPLATS = OrientedPoints.of(np.random.default_rng(4).uniform(-0.4, 0.4, (300, 3)).astype(np.float32))


def seen(seed=0) -> ShapeInputs:
    rng = np.random.default_rng(seed)
    volumes = rng.random((SOURCES, 4, CELLS, CELLS, CELLS), np.float32)
    evidence = rng.random((3, COARSE_CELLS, COARSE_CELLS, COARSE_CELLS), np.float32)
    return ShapeInputs(volumes, evidence, np.zeros(COPIES, np.float32), mirrors())


def answer(logits, seed=0) -> ShapeOutput:
    generator = torch.Generator().manual_seed(seed)
    sources = torch.randn(1, SOURCES + 1, *(COARSE_CELLS,) * 3, generator=generator)
    return ShapeOutput(logits[None], torch.zeros(1, 3, *(COARSE_CELLS,) * 3), sources)


def points(count=40, seed=0):
    generator = torch.Generator().manual_seed(seed)
    places = 0.8 * torch.rand(count, 3, generator=generator) - 0.4
    normals = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1)
    return places, normals


class Told:
    """A network that gives these scores, whatever it is asked."""

    def __init__(self, scores):
        self._scores = scores

    def scores(self, _):
        return self._scores


def column(features, name):
    return features[:, FEATURES.index(name)]


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_logits_are_read_along_the_way_in(slope_x, slope_z):
    slope = torch.tensor([slope_x, 0.5, slope_z])
    places, normals = points()
    found = depth_features(answer(CENTERS @ slope), seen(), 0.0, places, normals, SPLATS)
    for depth in DEPTHS:
        expected = (places - depth * CELL_SIDE * normals) @ slope
        # Linear fields are interpolated exactly, in float32.
        np.testing.assert_allclose(column(found, f"logit_{depth}"), expected, atol=2e-5)


def test_a_turned_object_has_the_same_features():
    logits = torch.randn(CELLS, CELLS, CELLS, generator=torch.Generator().manual_seed(1))
    inputs, output = seen(), answer(logits)
    turn = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned_inputs = dataclasses.replace(
        inputs,
        volumes=np.rot90(inputs.volumes, 1, (2, 3)).copy(),
        evidence=np.rot90(inputs.evidence, 1, (1, 2)).copy(),
    )
    turned = ShapeOutput(
        torch.rot90(output.occupancy, 1, (1, 2)),
        output.colors,
        torch.rot90(output.sources, 1, (2, 3)),
    )
    turned_splats = OrientedPoints(*(a @ turn.numpy().T for a in (SPLATS.points, SPLATS.normals)))
    places, normals = points()
    found = depth_features(output, inputs, 0.3, places, normals, SPLATS)
    asked = places @ turn.T, normals @ turn.T, turned_splats
    again = depth_features(turned, turned_inputs, 0.3, *asked)
    np.testing.assert_allclose(again, found, atol=1e-4)


def test_what_is_told_is_in_its_column():
    places, normals = points()
    found = depth_features(
        answer(torch.zeros(CELLS, CELLS, CELLS)), seen(), -1.0, places, normals, SPLATS
    )
    assert found.shape == (40, len(FEATURES))
    assert (column(found, "level") == -1.0).all()
    assert column(found, "score") == pytest.approx(mirrors()[0].score)
    np.testing.assert_allclose(column(found, "upward"), normals[:, 2])
    np.testing.assert_allclose(column(found, "height"), places[:, 2])
    crossed = crossings(places.numpy(), normals.numpy(), SPLATS)
    for k, name in enumerate(CROSSINGS):
        np.testing.assert_array_equal(column(found, f"continued_{name}"), crossed[:, k])


@given(st.lists(st.floats(-60, 60, width=32), min_size=25, max_size=25))
def test_the_median_depth_has_half_of_the_probability_on_either_side(logits):
    shares = softmax(np.array([logits], np.float32))
    depth = float(median_depth(shares)[0])
    upto = [np.clip((depth - middle) / 0.25 + 0.5, 0, 1) for middle in DEPTH_BINS]
    # float32: 25 sums; where hardly any probability is, the depth itself is rounded
    assert float(np.array(upto) @ shares[0]) == pytest.approx(0.5, abs=1e-4)


def test_where_one_bin_is_certain_its_middle_is_the_depth():
    logits = 50 * np.eye(len(DEPTH_BINS), dtype=np.float32)
    np.testing.assert_allclose(median_depth(softmax(logits)), DEPTH_BINS, atol=1e-6)


def test_depths_are_means_of_points_that_are_near_and_face_alike(monkeypatch):
    """A thin wall: of points that face each other only those on the same side count."""
    side = torch.linspace(-0.1, 0.1, 9)
    y, z = (v.flatten() for v in torch.meshgrid(side, side, indexing="ij"))
    front = torch.stack([torch.full_like(y, 0.01), y, z], dim=1)
    places = torch.cat([front, front * torch.tensor([-1.0, 1.0, 1.0])])
    normals = torch.zeros_like(places)
    normals[:81, 0], normals[81:, 0] = 1.0, -1.0
    bins = np.where(np.arange(162) < 81, DEPTH_BINS.index(1.0), DEPTH_BINS.index(3.0))
    bins[40] = DEPTH_BINS.index(2.0)  # in the middle of the front
    told = 50 * np.eye(len(DEPTH_BINS), dtype=np.float32)[bins]
    monkeypatch.setattr(surface_depth, "packaged_surface_depth", lambda: Told(told))
    asked = answer(torch.zeros(CELLS, CELLS, CELLS)), seen(), 0.0, places, normals, SPLATS
    cells = (surface_depths(*asked) / CELL_SIDE).numpy()
    assert cells[81:] == pytest.approx(3.0)
    # seven of eight neighbours are in the bin of 1, so the median is within it
    assert cells[40] == pytest.approx(1 + 0.25 * (0.5 / (7 / 8) - 0.5))
    assert cells[0] == pytest.approx(1.0)


def test_no_point_has_no_depth():
    nowhere = torch.zeros(0, 3)
    output = answer(torch.zeros(CELLS, CELLS, CELLS))
    assert surface_depths(output, seen(), 0.0, nowhere, nowhere, SPLATS).shape == (0,)


def test_depths_do_not_depend_on_threads():
    logits = 10 * (0.4 - CENTERS.norm(dim=-1))
    places, normals = points(6000)
    found = []
    for _ in each_thread_count():
        asked = answer(logits), seen(), 0.0, places, normals, SPLATS
        depths = surface_depths(*asked)
        found.append(depths.numpy().tobytes())
    assert len(set(found)) == 1
