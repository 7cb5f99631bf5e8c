"""Splats of a mesh cover it, all of it, and nothing else."""

from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.errors import UserError
from gscomplete.splats.filters import usable_rows
from gscomplete.splats.rotations import rotation_matrices
from splatcomplete_data.mesh import convert
from splatcomplete_data.mesh.allot import allot_by_spacing
from splatcomplete_data.mesh.convert import ConvertSettings, convert_mesh
from splatcomplete_data.mesh.edges import find_edges, marked_edges
from splatcomplete_data.mesh.files.load import Mesh, load_mesh
from splatcomplete_data.mesh.files.parts import MeshPart


def mesh_of(vertices: np.ndarray, **changes: object) -> Mesh:
    corners = vertices.astype(np.float32)
    return Mesh((MeshPart(corners, np.full_like(corners, 0.5), **changes),))  # type: ignore[arg-type]


def areas_of(vertices: np.ndarray) -> np.ndarray:
    edges = vertices[:, 1:] - vertices[:, :1]
    return 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)


def sphere(rings: int) -> np.ndarray:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=rings)
    return ball.vertices[ball.faces]


triangles = st.lists(
    st.lists(st.lists(st.floats(-1, 1, width=32), min_size=3, max_size=3), min_size=3, max_size=3),
    min_size=1,
    max_size=6,
)


@given(triangles, st.integers(1, 400), st.sampled_from(["cells", "grid", "random"]))
@settings(max_examples=80, deadline=None)
def test_splats_lie_on_their_triangles(corners: list, count: int, mode: str) -> None:
    vertices = np.array(corners, np.float64)
    vertices = vertices[areas_of(vertices) > 1e-5]
    if len(vertices) == 0:
        return
    splats = convert_mesh(
        mesh_of(vertices),
        count,
        settings=ConvertSettings(mode=mode),  # type: ignore[arg-type]
    ).splats
    for _, value in splats.fields():
        assert torch.isfinite(value).all()
    axes = rotation_matrices(splats.quaternions.double()).numpy()
    points = splats.means.double().numpy()
    best = np.full(len(points), np.inf)
    for triangle in vertices:
        normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        normal /= np.linalg.norm(normal)
        off = np.abs((points - triangle[0]) @ normal) + (1 - np.abs(axes[:, :, 2] @ normal))
        inverse = np.linalg.pinv((triangle[1:] - triangle[0]).T)
        uv = (points - triangle[0]) @ inverse.T
        outside = np.maximum(np.maximum(-uv.min(axis=1), uv.sum(axis=1) - 1), 0)
        best = np.minimum(best, off + outside)
    assert best.max() < 2e-3


@given(st.integers(10, 3000), st.floats(0.1, 1.0), st.floats(0.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_cells_add_up_to_the_triangle(count: int, height: float, apex: float) -> None:
    vertices = np.array([[[0, 0, 0], [1, 0, 0], [apex, height, 0]]])
    with mock.patch.multiple(convert, MOST_OVERHANG=np.inf, INSET=0.0):
        made = convert_mesh(mesh_of(vertices), count, settings=ConvertSettings(sigma_per_cell=1.0))
    covered = float((made.splats.scales[:, 0] * made.splats.scales[:, 1]).double().sum())
    assert covered == pytest.approx(0.5 * height, rel=0.35 if len(made.splats) < 30 else 0.12)


@pytest.mark.parametrize("count", [500, 20_000])
def test_the_count_is_met_and_the_sphere_has_no_hole(count: int) -> None:
    made = convert_mesh(mesh_of(sphere(4)), count)
    assert abs(len(made.splats) - count) <= 0.03 * count
    rng = np.random.default_rng(0)
    points = rng.normal(size=(400, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    distance = np.linalg.norm(points[:, None] - made.splats.means.numpy()[None], axis=2).min(axis=1)
    assert distance.max() < 1.6 * made.spacing


def test_a_triangle_whose_area_is_rounded_to_nothing_is_cut() -> None:
    """Its edges are exact opposites once 1e-25 is added to 769."""
    needle = [[-1.7e-25, 2.3e-41, 0], [-0.5, -1.7e-25, -769], [2.3e-41, 2.3e-41, 0]]
    plate = [[0, 0, 2], [100, 0, 2], [0, 100, 2]]
    made = convert_mesh(mesh_of(np.array([needle, plate])), 200)
    assert usable_rows(made.splats)[0].all()


def test_slivers_wires_and_specks_are_not_lost() -> None:
    sliver = [[0, 0, 0], [1, 0, 0], [0.5, 1e-4, 0]]
    speck = [[5, 5, 5], [5 + 1e-4, 5, 5], [5, 5 + 1e-4, 5]]
    plate = [[0, 0, 2], [1, 0, 2], [0, 1, 2]]
    made = convert_mesh(mesh_of(np.array([sliver, speck, plate])), 300)
    means = made.splats.means.numpy()
    wire = means[np.abs(means[:, 2]) < 1e-6]
    assert len(wire) >= 1
    assert (np.linalg.norm(means - [5, 5, 5], axis=1) < 1e-3).sum() == 1
    lone = made.splats.select(torch.from_numpy(means[:, 2] > 4))
    assert float(lone.scales.max()) < 1e-3  # no larger than what it stands for
    lengths = made.splats.scales[torch.from_numpy(np.abs(means[:, 2]) < 1e-6)]
    assert float(lengths[:, 0].sum()) > 0.4  # the wire is covered along its length
    assert float(lengths[:, 1].max()) < 0.1 * made.spacing  # and does not bulge


@given(st.floats(0.001, 1.0), st.floats(-0.5, 1.5), st.integers(50, 2000), st.floats(0.001, 0.2))
@settings(max_examples=40, deadline=None)
def test_no_splat_is_a_needle_or_reaches_beyond_the_edge(
    height: float, apex: float, count: int, thick: float
) -> None:
    """Of a lone triangle, and of a long thin plank of two."""
    lone = np.array([[[0, 0, 0], [1, 0, 0], [apex, height, 0]]])
    plank = np.array(
        [[[0, 0, 0], [1, 0, 0], [1, thick, 0]], [[0, 0, 0], [1, thick, 0], [0, thick, 0]]]
    )
    for vertices, outline in ((lone, lone[0]), (plank, plank.reshape(-1, 3)[[0, 1, 2, 5]])):
        made = convert_mesh(mesh_of(vertices), count)
        scales = made.splats.scales.double().numpy()
        aspect = scales[:, :2].max(axis=1) / scales[:, :2].min(axis=1)
        assert aspect.max() < 16  # 8 along the surface; shortening at a tip may double it
        axes = rotation_matrices(made.splats.quaternions.double()).numpy()
        beyond = 0.0
        for angle in np.linspace(0, 2 * np.pi, 16, endpoint=False):
            along = np.cos(angle) * scales[:, :1] * axes[:, :, 0]
            along = along + np.sin(angle) * scales[:, 1:2] * axes[:, :, 1]
            rim = made.splats.means.double().numpy() + convert.REACH_SIGMAS * along
            beyond = max(beyond, float(distance_outside(rim[:, :2], outline[:, :2]).max()))
        assert beyond < (convert.MOST_OVERHANG + 0.05) * made.spacing


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:  # [..., 2] twice
    """Return the vertical component of the cross product of level vectors."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def distance_outside(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Return how far points [N, 2] lie outside a convex outline [K, 2]; 0 inside."""
    turn = cross(outline[1] - outline[0], outline[2] - outline[1])
    outside, nearest = np.zeros(len(points), bool), np.full(len(points), np.inf)
    for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        edge, off = end - start, points - start
        outside |= np.sign(turn) * cross(edge, off) < 0
        share = np.clip(off @ edge / (edge @ edge), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(off - share[:, None] * edge, axis=1))
    return np.where(outside, nearest, 0.0)


def test_a_fine_mesh_is_not_counted_per_triangle() -> None:
    vertices = sphere(5)  # 20,480 triangles
    made = convert_mesh(mesh_of(vertices), 2000)
    assert 1500 < len(made.splats) < 2500
    radius = np.linalg.norm(made.splats.means.numpy(), axis=1)
    assert radius.min() > 0.99


def test_borders_and_folds_are_marked_and_inset() -> None:
    square = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]])
    normals = np.tile([0.0, 0.0, 1.0], (2, 1))
    edges, ends = marked_edges(find_edges(square.astype(np.float32)), normals, 35.0)
    assert (edges.tolist(), ends.tolist()) == ([0b011, 0b110], [0b111, 0b111])
    lows = []
    for inset in (0.0, 0.4):
        with mock.patch.object(convert, "INSET", inset):
            made = convert_mesh(mesh_of(square), 400)
        lows.append(made.splats.means[:, :2].min().item())
    assert 0.01 < lows[0] < 0.03  # about half a cell of 1 / 20
    assert lows[1] > lows[0] + 0.005
    folded = square.copy()
    folded[1, 2] = [0, 0, 1]
    normals = np.cross(folded[:, 1] - folded[:, 0], folded[:, 2] - folded[:, 0]).astype(float)
    edges, _ = marked_edges(find_edges(folded.astype(np.float32)), normals, 35.0)
    assert edges.tolist() == [0b111, 0b111]


def fan(number: int) -> np.ndarray:  # [number, 3, 3]
    """A disc about the origin, its triangles like a cake's pieces."""
    angle = np.arange(number + 1) * 2 * np.pi / number
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return np.stack([np.zeros((number, 3)), rim[:-1], rim[1:]], axis=1)


@pytest.mark.parametrize(("height", "expected"), [(0.0, 0b110), (0.01, 0b110), (0.3, 0b111)])
def test_only_the_middle_of_a_flat_fan_is_surrounded(height: float, expected: int) -> None:
    """Neighbours of a cone of height 0.3 fold by 12 degrees."""
    cone = fan(8)
    cone[:, 0, 2] = height
    normals = np.cross(cone[:, 1] - cone[:, 0], cone[:, 2] - cone[:, 0])
    edges, ends = marked_edges(find_edges(cone.astype(np.float32)), normals, 35.0)
    assert set(edges.tolist()) == {0b010}
    assert set(ends.tolist()) == {expected}


@pytest.mark.parametrize("number", [12, 32, 64])
def test_a_fan_has_no_hole_at_its_middle(number: int) -> None:
    """As in the cap of every cylinder; without slices nothing lies within 2 spacings of it."""
    made = convert_mesh(mesh_of(fan(number)), 5000)
    places, scales = made.splats.means[:, :2], made.splats.scales[:, :2]
    axes = rotation_matrices(made.splats.quaternions)[:, :2, :2]
    for distance in (0.0, 0.5, 1.0, 2.0, 4.0, 8.0):
        angle = torch.arange(24) * 2 * np.pi / 24
        at = distance * made.spacing * torch.stack([angle.cos(), angle.sin()], dim=1)
        local = torch.einsum("snc,nck->snk", at[:, None] - places, axes) / scales
        alpha = made.splats.opacities * torch.exp(-0.5 * local.square().sum(dim=2))
        assert (1 - (1 - alpha).prod(dim=1)).min() > 0.5
    assert float((scales.amax(dim=1) / scales.amin(dim=1)).max()) < 8


def test_grid_counts_what_it_would_have_missed() -> None:
    tiny = [[0.51, 0.51, 0], [0.52, 0.51, 0], [0.51, 0.52, 0]]
    plate = [[0, 0, 1], [4, 0, 1], [0, 4, 1]]
    made = convert_mesh(
        mesh_of(np.array([tiny, plate])), spacing=1.0, settings=ConvertSettings(mode="grid")
    )
    assert len(made.splats) == 1 + 10
    assert "1 triangles contain no grid point" in made.steps[1].note
    slanted = np.array([[[0, 0, 0], [4, 0, 4], [0, 4, 0]]])
    scales = convert_mesh(
        mesh_of(slanted), spacing=1.0, settings=ConvertSettings(mode="grid", sigma_per_cell=1.0)
    ).splats.scales
    np.testing.assert_allclose(scales[:, 0], np.sqrt(2), rtol=1e-5)  # stretched along the slope
    np.testing.assert_allclose(scales[:, 1], 1.0, rtol=1e-5)


def test_blended_surfaces_keep_their_alpha_and_cut_outs_go() -> None:
    square = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]]])
    glass = convert_mesh(mesh_of(square, alpha=0.3, blended=True), 50)
    np.testing.assert_allclose(glass.splats.opacities, 0.3 * 0.99, rtol=1e-5)
    with pytest.raises(UserError, match="transparency everywhere"):
        convert_mesh(mesh_of(square, alpha=0.3), 50)
    assert float(convert_mesh(mesh_of(square), 50).splats.opacities.max()) < 1  # finite logits


def test_requests_out_of_range_are_user_errors() -> None:
    mesh = mesh_of(sphere(1))
    for count, spacing in ((None, None), (5, 0.1), (0, None), (None, -1.0), (None, 1e-9)):
        with pytest.raises(UserError, match="mesh"):
            convert_mesh(mesh, count, spacing=spacing)
    assert allot_by_spacing(sphere(1).astype(np.float32), areas_of(sphere(1)), 0.1).total > 500


def test_missing_files_draco_and_splats_are_noticed(tmp_path: Path) -> None:
    obj = "mtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 nan\nf 1 2 3\nf 1 2 4\nf 1 1 2\n"
    (tmp_path / "a.obj").write_text(obj)
    mesh = load_mesh(tmp_path / "a.obj")
    assert any("gone.mtl" in note for note in mesh.notes)
    assert (mesh.degenerate, mesh.non_finite) == (1, 1)
    (tmp_path / "d.gltf").write_text('{"extensionsRequired": ["KHR_draco_mesh_compression"]}')
    with pytest.raises(UserError, match="Draco"):
        load_mesh(tmp_path / "d.gltf")
    (tmp_path / "s.ply").write_text("ply\nformat ascii 1.0\nproperty float rot_0\nend_header\n")
    with pytest.raises(UserError, match="Gaussian splats"):
        load_mesh(tmp_path / "s.ply")
    with pytest.raises(UserError, match="found none"):
        load_mesh(tmp_path / "no.obj")
