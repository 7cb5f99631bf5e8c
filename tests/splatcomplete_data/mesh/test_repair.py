"""MeshLab's part: repair counts and orientation, Poisson disks that keep their distance."""

import importlib.util
import sys

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from gscomplete.errors import UserError
from gscomplete.util import optional
from splatcomplete_data.mesh import meshlab
from splatcomplete_data.mesh.convert import ConvertSettings, convert_mesh
from splatcomplete_data.mesh.files.load import Mesh
from splatcomplete_data.mesh.files.parts import MeshPart
from splatcomplete_data.mesh.repair import repair_mesh
from splatcomplete_data.mesh.sampling import point_frames, poisson_points, uniform_points

needs_meshlab = pytest.mark.skipif(
    importlib.util.find_spec("pymeshlab") is None, reason="pymeshlab is not installed"
)


def sphere(subdivisions: int) -> np.ndarray:  # [T, 3, 3]
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    return ball.vertices[ball.faces].astype(np.float32)


def volume(vertices: np.ndarray) -> float:
    return float(np.linalg.det(vertices.astype(np.float64)).sum() / 6)


@needs_meshlab
def test_repair_counts_and_turns(monkeypatch):
    monkeypatch.setattr(meshlab, "_in_own_process", lambda function, *args: function(*args))
    good = sphere(2)
    broken = good.copy()
    wrong = np.arange(0, len(good), 5)
    broken[wrong] = broken[wrong][:, [0, 2, 1]]
    null = np.repeat(good[:3, :1], 3, axis=1)
    whole = np.concatenate([broken, good[7:11], null])
    colors = np.arange(whole.size, dtype=np.float32).reshape(whole.shape) / whole.size
    split = 100  # two parts, so that indices have to be told apart
    parts = (
        MeshPart(whole[:split], colors[:split], uv=colors[:split, :, :2].copy()),
        MeshPart(whole[split:], colors[split:]),
    )
    mesh, steps = repair_mesh(Mesh(parts))
    by_name = {step.name: step for step in steps}
    assert by_name["merge_vertices"].after == len(np.unique(good.reshape(-1, 3), axis=0))
    assert by_name["drop_null_faces"].reasons == {"no_area": 3}
    assert by_name["drop_duplicate_faces"].reasons == {"duplicate": 4}
    kept = np.concatenate([part.vertices for part in mesh.parts])
    assert len(kept) == len(good)
    assert abs(volume(kept)) == pytest.approx(volume(good), rel=1e-5)  # all face one side
    turned = int(by_name["orient_faces"].note.split()[0])
    assert len(wrong) - 4 <= min(turned, len(good) - turned) <= len(wrong)
    # every corner still has its own colour
    known = {
        tuple(c): tuple(v) for c, v in zip(colors.reshape(-1, 3), whole.reshape(-1, 3), strict=True)
    }
    for part in mesh.parts:
        for corner, color in zip(
            part.vertices.reshape(-1, 3), part.colors.reshape(-1, 3), strict=True
        ):
            assert known[tuple(color)] == tuple(corner)
    assert mesh.parts[0].uv is not None
    np.testing.assert_array_equal(mesh.parts[0].uv, mesh.parts[0].colors[:, :, :2])


@needs_meshlab
def test_what_is_not_a_manifold_is_said(monkeypatch):
    monkeypatch.setattr(meshlab, "_in_own_process", lambda function, *args: function(*args))
    fan = np.array([[[0, 0, 0], [1, 0, 0], p] for p in ([0, 1, 0], [0, -1, 0], [0, 0, 1])])
    fan = fan.astype(np.float32)
    mesh, steps = repair_mesh(Mesh((MeshPart(fan, np.ones_like(fan)),)))
    assert mesh.triangles == 3
    assert "not a manifold" in steps[-1].note


@needs_meshlab
def test_poisson_disks_keep_their_distance_and_repeat():
    vertices = sphere(3)
    mesh = Mesh((MeshPart(vertices, np.full_like(vertices, 0.5)),))
    settings = ConvertSettings(mode="poisson", seed=3)
    made = convert_mesh(mesh, 1500, settings=settings)
    assert 0.9 * 1500 < len(made.splats) < 1.1 * 1500
    points = made.splats.means.double().numpy()
    nearest = cKDTree(points).query(points, k=2)[0][:, 1]
    assert nearest.min() > 0.7 * made.spacing  # uniform points: 0.01 and less
    assert torch.isfinite(made.splats.quaternions).all()
    again = convert_mesh(mesh, 1500, settings=settings)
    assert torch.equal(made.splats.means, again.splats.means)


def test_point_frames_move_weights_by_a_quarter_of_the_side():
    rng = np.random.default_rng(0)
    vertices = rng.normal(size=(20, 3, 3)).astype(np.float32)
    areas = 0.5 * np.linalg.norm(
        np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0]), axis=1
    )
    triangle, weights = uniform_points(areas.astype(np.float64), 50, 0)
    side = 1e-3
    axes, steps = point_frames(vertices, triangle, side)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)
    assert (weights >= -1e-6).all()
    for n, t in enumerate(triangle):
        for axis in range(2):
            moved = steps[n, axis].astype(np.float64) @ vertices[t]
            np.testing.assert_allclose(moved, side / 4 * axes[n, axis], atol=2e-6)
        assert abs(axes[n, 0] @ axes[n, 1]) < 1e-6


def test_absent_meshlab_is_one_line(monkeypatch):
    monkeypatch.setattr(meshlab, "_in_own_process", lambda function, *args: function(*args))
    monkeypatch.setitem(sys.modules, "pymeshlab", None)
    vertices = sphere(1)
    with pytest.raises(UserError, match=r"mesh repair needs pymeshlab .*gscomplete\[data"):
        meshlab.repair_triangles(vertices)
    with pytest.raises(UserError, match="Poisson-disk sampling needs pymeshlab"):
        poisson_points(vertices, np.ones(len(vertices)), 10, 0)
    assert "\n" not in optional.EXTRA
