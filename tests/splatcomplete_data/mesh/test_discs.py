from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatcomplete_data.mesh.discs import (
    ColoredTriangles,
    discs_at,
    quaternions_from_normals,
    sample_triangles,
    triangle_areas_and_normals,
    triangles_to_discs,
)

DATA = Path(__file__).resolve().parents[3] / "../shared/data"


def sphere(rows: int = 24, columns: int = 48) -> np.ndarray:
    """Return the triangles [T, 3, 3] of a unit sphere, corners anticlockwise from outside."""
    phi = np.linspace(-np.pi / 2, np.pi / 2, rows + 1)
    theta = np.linspace(0, 2 * np.pi, columns + 1)
    grid = np.stack(
        [
            np.cos(phi)[:, None] * np.cos(theta),
            np.cos(phi)[:, None] * np.sin(theta),
            np.broadcast_to(np.sin(phi)[:, None], (rows + 1, columns + 1)),
        ],
        axis=-1,
    )
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    triangles = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)])
    return triangles.reshape(-1, 3, 3).astype(np.float32)


def third_axis(quaternions: np.ndarray) -> np.ndarray:
    """Slow float64 twin: where unit quaternions take the z axis."""
    w, x, y, z = quaternions.astype(np.float64).T
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-1, 1, width=32), min_size=3, max_size=3), st.floats(1e-6, 1e6))
def test_quaternions_turn_z_onto_the_normal_or_its_opposite(direction, length):
    normal = np.array(direction, np.float64)
    if np.linalg.norm(normal) < 1e-3:
        return
    normal = normal / np.linalg.norm(normal)
    quaternion = quaternions_from_normals((normal[None] * length).astype(np.float32))
    assert np.allclose(np.linalg.norm(quaternion, axis=1), 1, atol=1e-5)
    assert abs(abs(float(third_axis(quaternion)[0] @ normal)) - 1) < 1e-5


def test_zero_normals_give_the_identity():
    assert np.array_equal(quaternions_from_normals(np.zeros((1, 3), np.float32)), [[1, 0, 0, 0]])


def test_samples_share_out_by_area_and_lie_on_their_triangles():
    rng = np.random.default_rng(0)
    vertices = rng.normal(size=(40, 3, 3)).astype(np.float32)
    vertices[3] = vertices[3, :1]  # no area
    count = 4000
    triangle, weights = sample_triangles(vertices, count, seed=1)
    areas = triangle_areas_and_normals(vertices)[0]
    found = np.bincount(triangle, minlength=40)
    assert np.abs(found - count * areas / areas.sum()).max() <= 2
    assert found[3] == 0
    assert weights.min() >= 0
    assert np.allclose(weights.sum(axis=1), 1, atol=1e-6)


def test_same_seed_same_samples():
    first, second = (sample_triangles(sphere(), 500, seed=4) for _ in range(2))
    other = sample_triangles(sphere(), 500, seed=5)
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
    assert not np.array_equal(first[1], other[1])


def test_discs_of_a_sphere_cover_it_and_face_outward():
    vertices = sphere()
    colors = np.full_like(vertices, 0.25)
    splats = triangles_to_discs(ColoredTriangles(vertices, colors), 2000, seed=3)
    points = splats.means.numpy()
    assert np.abs(np.linalg.norm(points, axis=1) - 1).max() < 0.02
    normals = third_axis(splats.quaternions.numpy())
    assert np.abs(np.einsum("ij,ij->i", normals, points)).min() > 0.98
    assert torch.allclose(splats.base_colors, torch.full((2000, 3), 0.25), atol=1e-6)
    probes = np.random.default_rng(0).normal(size=(300, 3))
    probes /= np.linalg.norm(probes, axis=1, keepdims=True)
    gap = np.linalg.norm(probes[:, None] - points[None], axis=2).min(axis=1)
    assert (gap / splats.scales[0, 0].item()).max() < 3.2  # nowhere beyond reach of a disc
    assert np.isclose(splats.scales[0, 2] / splats.scales[0, 0], 0.05)


def test_corner_colors_are_interpolated():
    vertices = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float32)
    corner = np.array([[[0, 0, 1], [1, 0, 0], [0, 1, 0]]], np.float32)
    splats = triangles_to_discs(ColoredTriangles(vertices, corner), 64)
    x, y = splats.means[:, 0], splats.means[:, 1]
    assert torch.allclose(splats.base_colors, torch.stack([x, y, 1 - x - y], dim=1), atol=1e-5)


def test_spacings_shape_the_discs():
    points = np.zeros((2, 3), np.float32)
    normals = np.array([[0, 0, 1], [1, 0, 0]], np.float32)
    splats = discs_at(points, normals, points, np.array([0.1, 0.2]), opacity=0.5)
    assert np.allclose(splats.scales, [[0.06, 0.06, 0.003], [0.12, 0.12, 0.006]])
    assert splats.opacities.tolist() == [0.5, 0.5]


@pytest.mark.parametrize("vertices", [np.zeros((0, 3, 3)), np.zeros((3, 3, 3))])
def test_surfaces_without_area_are_refused(vertices):
    with pytest.raises(ValueError, match="area"):
        sample_triangles(vertices.astype(np.float32), 10, 0)


def test_wrong_shapes_and_counts_are_refused():
    good = np.zeros((2, 3, 3), np.float32)
    with pytest.raises(ValueError, match=r"colors: expected \(T, 3, 3\)"):
        ColoredTriangles(good, good[0])
    with pytest.raises(ValueError, match="expected 2 triangles, found 1"):
        ColoredTriangles(good, good[:1])
    with pytest.raises(ValueError, match="count must be positive"):
        sample_triangles(sphere(), 0, 0)


def test_a_real_mesh_turns_into_discs():
    trimesh = pytest.importorskip("trimesh")
    files = sorted((DATA / "mesh").rglob("*.obj")) if DATA.exists() else []
    if not files:
        pytest.skip("shared/data with OBJ meshes is absent")
    path = min(files, key=lambda p: p.stat().st_size)
    mesh = trimesh.load(path, force="mesh", process=False, skip_materials=True)
    vertices = np.asarray(mesh.triangles, np.float32)
    splats = triangles_to_discs(ColoredTriangles(vertices, np.full_like(vertices, 0.5)), 1000)
    assert all(torch.isfinite(value).all() for _, value in splats.fields())
    low, high = vertices.min(axis=(0, 1)), vertices.max(axis=(0, 1))
    slack = 1e-5 * float((high - low).max())
    assert (splats.means.numpy() >= low - slack).all()
    assert (splats.means.numpy() <= high + slack).all()
