import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from gscomplete.shape.network import ShapeOutput
from gscomplete.shape.partial_voxels import ShapeInputs
from gscomplete.shape.surface import depth as surface_depth
from gscomplete.shape.surface.depth import (
    DEPTHS,
    FEATURES,
    depth_features,
    surface_depths,
)
from gscomplete.shape.symmetry import COPIES, SOURCES
from gscomplete.shape.voxels import CELL_SIDE, CELLS, COARSE_CELLS, cell_centers
from tests.builders.shape_network import mirrors
from tests.builders.threads import each_thread_count

CENTERS = torch.from_numpy(cell_centers(CELLS)).float()


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


def column(features, name):
    return features[:, FEATURES.index(name)]


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_logits_are_read_along_the_way_in(slope_x, slope_z):
    slope = torch.tensor([slope_x, 0.5, slope_z])
    places, normals = points()
    found = depth_features(answer(CENTERS @ slope), seen(), 0.0, places, normals)
    for depth in DEPTHS:
        expected = (places - depth * CELL_SIDE * normals) @ slope
        # Linear fields are interpolated exactly, in float32.
        np.testing.assert_allclose(column(found, f"logit_{depth}"), expected, atol=2e-5)


def test_a_turned_object_has_the_same_features():
    logits = torch.randn(CELLS, CELLS, CELLS, generator=torch.Generator().manual_seed(1))
    inputs, output = seen(), answer(logits)
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
    turn = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    places, normals = points()
    found = depth_features(output, inputs, 0.3, places, normals)
    again = depth_features(turned, turned_inputs, 0.3, places @ turn.T, normals @ turn.T)
    np.testing.assert_allclose(again, found, atol=1e-4)


def test_what_is_told_is_in_its_column():
    places, normals = points()
    found = depth_features(answer(torch.zeros(CELLS, CELLS, CELLS)), seen(), -1.0, places, normals)
    assert found.shape == (40, len(FEATURES))
    assert (column(found, "level") == -1.0).all()
    assert column(found, "score") == pytest.approx(mirrors()[0].score)
    np.testing.assert_allclose(column(found, "upward"), normals[:, 2])
    np.testing.assert_allclose(column(found, "height"), places[:, 2])


def test_depths_are_means_of_points_that_are_near_and_face_alike(monkeypatch):
    """A thin wall: of points that face each other only those on the same side count."""
    side = torch.linspace(-0.1, 0.1, 9)
    y, z = (v.flatten() for v in torch.meshgrid(side, side, indexing="ij"))
    front = torch.stack([torch.full_like(y, 0.01), y, z], dim=1)
    places = torch.cat([front, front * torch.tensor([-1.0, 1.0, 1.0])])
    normals = torch.zeros_like(places)
    normals[:81, 0], normals[81:, 0] = 1.0, -1.0
    told = np.where(np.arange(162) < 81, 1.0, 3.0).astype(np.float32)
    told[40] = 2.0  # in the middle of the front
    monkeypatch.setattr(surface_depth, "packaged_surface_depth", lambda: lambda _: told)
    asked = answer(torch.zeros(CELLS, CELLS, CELLS)), seen(), 0.0, places, normals
    cells = (surface_depths(*asked) / CELL_SIDE).numpy()
    assert cells[81:] == pytest.approx(3.0)
    assert cells[40] == pytest.approx(1 + 1 / 8)
    assert cells[0] == pytest.approx(1.0)


def test_no_point_has_no_depth():
    nowhere = torch.zeros(0, 3)
    output = answer(torch.zeros(CELLS, CELLS, CELLS))
    assert surface_depths(output, seen(), 0.0, nowhere, nowhere).shape == (0,)


def test_depths_do_not_depend_on_threads():
    logits = 10 * (0.4 - CENTERS.norm(dim=-1))
    places, normals = points(6000)
    found = []
    for _ in each_thread_count():
        depths = surface_depths(answer(logits), seen(), 0.0, places, normals)
        found.append(depths.numpy().tobytes())
    assert len(set(found)) == 1
