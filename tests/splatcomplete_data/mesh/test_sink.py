"""Splats sink below surfaces that have an inside, and no side comes out at the other."""

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.splats.rotations import rotation_matrices
from splatcomplete_data.mesh.convert import Conversion, ConvertSettings, convert_mesh
from splatcomplete_data.mesh.edges import find_edges, inside_of
from splatcomplete_data.mesh.files.load import Mesh
from splatcomplete_data.mesh.files.parts import MeshPart
from splatcomplete_data.mesh.sink import DEPTH_PX, MOST_SPACINGS

OTHERWISE_ROUND = [0, 2, 1]


def box(x: float, y: float, z: float) -> np.ndarray:  # [12, 3, 3]
    solid = trimesh.creation.box((x, y, z))
    return solid.vertices[solid.faces]


def ball() -> np.ndarray:
    solid = trimesh.creation.icosphere(subdivisions=3)
    return 0.5 * solid.vertices[solid.faces]


def sheet(cuts: int) -> np.ndarray:  # [2 cuts^2, 3, 3]
    at = np.arange(cuts) / cuts
    low = np.stack([*np.meshgrid(at, at), np.zeros((cuts, cuts))], axis=-1).reshape(-1, 1, 3)
    squares = [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]
    return np.concatenate([low + np.array(half) / cuts for half in squares])


def converted(vertices: np.ndarray, count: int, outline_px: float = 512.0) -> Conversion:
    corners = vertices.astype(np.float32)
    mesh = Mesh((MeshPart(corners, np.full_like(corners, 0.5)),))
    return convert_mesh(mesh, count, settings=ConvertSettings(outline_px=outline_px))


def inside(vertices: np.ndarray) -> list[int]:
    corners = vertices.astype(np.float32)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return inside_of(find_edges(corners), corners, normals.astype(np.float64)).tolist()


@pytest.mark.parametrize("order", [[0, 1, 2], OTHERWISE_ROUND])
@pytest.mark.parametrize(("count", "outline_px"), [(20_000, 512.0), (200_000, 64.0)])
def test_a_ball_shrinks_however_it_is_wound(
    order: list[int], count: int, outline_px: float
) -> None:
    on, below = (converted(ball()[:, order], count, px) for px in (0.0, outline_px))
    depth = min(DEPTH_PX / outline_px, MOST_SPACINGS * below.spacing)
    shift = on.splats.means.norm(dim=1) - below.splats.means.norm(dim=1)
    # a chord's normal leans by up to the angle of half a triangle: 4 degrees
    assert torch.allclose(shift, torch.full_like(shift, depth), rtol=5e-3)
    assert "below the surface" in below.steps[1].note
    assert "below the surface" not in on.steps[1].note


def test_a_sheet_stays() -> None:
    assert float(converted(sheet(8), 2000).splats.means[:, 2].abs().max()) == 0.0


def test_which_side_is_inside() -> None:
    cube = box(1, 1, 1)
    assert set(inside(cube)) == {-1}
    assert set(inside(cube[:, OTHERWISE_ROUND])) == {1}
    without_lid = cube[cube[:, :, 2].min(axis=1) < 0]
    assert len(without_lid) == 10
    assert set(inside(without_lid)) == {-1}
    assert set(inside(sheet(8))) == {0}
    turned = cube.copy()
    turned[4] = turned[4, OTHERWISE_ROUND]
    assert inside(turned) == [-1] * 4 + [0] + [-1] * 7  # one triangle contradicts the others
    shell = np.concatenate([ball(), 0.98 * ball()[:, OTHERWISE_ROUND]])
    assert inside(shell) == [-1] * len(ball()) + [1] * len(ball())
    far = cube + np.array([300.0, -200.0, 100.0])
    assert set(inside(far)) == {-1}


@given(st.floats(1e-4, 0.2), st.integers(300, 20_000))
@settings(max_examples=15, deadline=None)
def test_the_sides_of_a_plate_do_not_change_places(thick: float, count: int) -> None:
    made = converted(box(1, 0.7, thick), count)
    normals = rotation_matrices(made.splats.quaternions)[:, :, 2]
    faces = made.splats.means[normals[:, 2].abs() > 0.9, 2]
    assert float(faces.abs().max()) <= 0.5 * thick * (1 + 1e-5)
    apart = min(0.5 * thick, 0.25 * made.spacing)  # sides stay half a spacing apart
    assert float(faces.abs().min()) >= apart * (1 - 1e-5)
    both = faces.sign().sum().abs() / len(faces)
    assert both < 0.1


def test_twins_in_one_place_stay() -> None:
    """Two sheets back to back, joined at their rims: a flag whose sides differ."""
    flat = sheet(6)
    flag = np.concatenate([flat, flat[:, OTHERWISE_ROUND]])
    assert float(converted(flag, 3000).splats.means[:, 2].abs().max()) == 0.0


def test_depths_are_those_of_a_slow_twin() -> None:
    """A wedge, from a knife's edge to thicker than the search reaches, and turned."""
    rng = np.random.default_rng(1)
    ends = np.array([[0, 0, 0], [1, 0, 0.04], [1, 0, -0.04]], float)
    solid = trimesh.convex.convex_hull(np.concatenate([ends, ends + np.array([0, 0.6, 0])]))
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    vertices = solid.vertices[solid.faces] @ turn.T
    on, below = converted(vertices, 6000, 0.0), converted(vertices, 6000, 40.0)
    means = on.splats.means.double().numpy()
    moved = np.linalg.norm(below.splats.means.double().numpy() - means, axis=1)
    normals = rotation_matrices(on.splats.quaternions.double())[:, :, 2].numpy()
    normals *= np.sign((normals * (means - vertices.mean(axis=(0, 1)))).sum(axis=1))[:, None]
    size = float(np.ptp(vertices.reshape(-1, 3), axis=0).max())
    depth = min(DEPTH_PX * size / 40.0, MOST_SPACINGS * on.spacing)
    for n in range(0, len(means), 7):
        away = means - means[n]
        along = -away @ normals[n]
        beside = np.sqrt(np.maximum((away**2).sum(axis=1) - along**2, 0.0))
        behind = (normals @ normals[n] < -0.5) & (along >= -1e-3 * on.spacing)
        behind &= beside < 0.75 * on.spacing
        limit = 0.5 * max(along[behind].min(initial=np.inf) - 0.5 * on.spacing, 0.0)
        # float32 places of size 1
        assert moved[n] == pytest.approx(min(depth, limit), abs=1e-6)
    assert 0.1 < (moved < 0.99 * depth).mean() < 0.9
