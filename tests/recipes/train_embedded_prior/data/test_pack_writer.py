import numpy as np
import pytest
import trimesh

from gscomplete.errors import UserError
from recipes.train_embedded_prior.data.mesh_pack import PackEntry, PackMesh, read_mesh
from recipes.train_embedded_prior.data.pack_writer import packed, write_packed
from splatcomplete_data.mesh.files.load import Mesh
from splatcomplete_data.mesh.files.parts import GREY, MeshPart

ENTRY = PackEntry("one", "train", "thing", "thing", "here", "CC0-1.0", "", "")
AS_IT_IS = np.eye(3)


def soup(mesh: trimesh.Trimesh, colors: np.ndarray, alpha: float = 1.0) -> MeshPart:
    corners = np.broadcast_to(colors, (len(mesh.faces), 3, 3)).astype(np.float32)
    return MeshPart(mesh.vertices[mesh.faces].astype(np.float32), corners, alpha=alpha)


def packed_and_read(tmp_path, mesh: Mesh, upright=AS_IT_IS, most_faces=4000) -> PackMesh:
    write_packed(tmp_path / "one.npz", packed(mesh, upright, most_faces), unit_m=1.0, made_of="")
    return read_mesh(tmp_path, ENTRY)


def places_of(mesh: PackMesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points [N, 3] of the surface, evenly over faces, and their colours [N, 3]."""
    rng = np.random.default_rng(1)
    face, weights = rng.integers(len(mesh.faces), size=count), rng.dirichlet((1, 1, 1), count)
    weights = weights.astype(np.float32)
    points = np.einsum("nk,nkc->nc", weights, mesh.vertices[mesh.faces][face])
    return points, mesh.colors_at(face, weights)


def test_textures_come_back_where_they_were(tmp_path):
    corners = np.array([[[0, 0, 0], [2, 0, 0], [2, 0, 1]], [[0, 0, 0], [2, 0, 1], [0, 0, 1]]])
    uv = 0.1 + 0.8 * corners[:, :, [0, 2]] / (2, 1)  # textures repeat: away from their borders
    column, row = np.meshgrid(*[(np.arange(64) + 0.5) / 64] * 2)
    texture = np.stack([column, 1 - row, 0.5 + 0 * row, 1 + 0 * row], axis=2).astype(np.float32)
    white = np.ones((2, 3, 3), np.float32)
    part = MeshPart(corners.astype(np.float32), white, uv.astype(np.float32), texture)
    mesh = packed_and_read(tmp_path, Mesh((part,)))
    points, colors = places_of(mesh, 500)
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([1, 0, 0.5], abs=1e-6)
    along, up = points[:, 0] + 0.5, 2 * points[:, 2] + 0.5
    expected = np.stack([0.1 + 0.8 * along, 0.1 + 0.8 * up, 0.5 + 0 * up], axis=1)
    errors = np.abs(colors - expected).max(axis=1)
    # a texel of 64 along each side; two faces share the texels where their block is cut
    assert np.quantile(errors, 0.96) < 0.8 / 64 + 0.01


def test_many_faces_become_few_with_the_colours_of_their_places(tmp_path):
    ball = trimesh.creation.icosphere(5, radius=3.0)
    is_upper = ball.triangles_center[:, 2] > 0
    colors = np.where(is_upper[:, None], (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))[:, None]
    reduced = packed(Mesh((soup(ball, colors),)), AS_IT_IS, 1000)
    assert (reduced.faces_source, reduced.see_through, reduced.side) == (20480, 0, 6.0)
    assert 900 <= reduced.faces <= 1000
    mesh = packed_and_read(tmp_path, Mesh((soup(ball, colors),)), most_faces=1000)
    points, found = places_of(mesh, 2000)
    # a thousand equilateral faces would reach .0024 below a ball of radius .5; these are less even
    assert np.abs(np.linalg.norm(points, axis=1) - 0.5).max() < 0.005
    off_middle = np.abs(points[:, 2]) > 0.03  # where a texel of the other half is not near
    is_red = found[:, 0] > found[:, 2]
    assert (is_red == (points[:, 2] > 0))[off_middle].all()


def test_objects_stand_upright_with_plain_colours_and_without_what_cannot_be_seen(tmp_path):
    box, pane = trimesh.creation.box((1, 2, 3)), trimesh.creation.box((9, 9, 9))
    red, blue = np.array((1.0, 0.0, 0.0)), np.array((0.0, 0.0, 1.0))
    hidden = soup(pane, blue, alpha=0.05)
    y_up = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    found = packed(Mesh((soup(box, red), hidden)), y_up, 4000)
    assert (found.colour, found.faces, found.see_through) == ("single", 12, 12)
    mesh = packed_and_read(tmp_path, Mesh((soup(box, red), hidden)), y_up)
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([1 / 3, 1, 2 / 3], abs=1e-6)
    assert places_of(mesh, 50)[1] == pytest.approx(np.tile(red, (50, 1)))
    grey = Mesh((soup(box, np.full(3, GREY)),))
    assert packed(grey, AS_IT_IS, 4000).colour == "none"
    two = Mesh((soup(box, red), soup(pane, blue)))
    assert packed(two, AS_IT_IS, 4000).colour == "flat"
    with pytest.raises(UserError, match="transparent"):
        packed(Mesh((hidden,)), AS_IT_IS, 4000)
