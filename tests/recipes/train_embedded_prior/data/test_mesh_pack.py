import numpy as np
import pytest

from gscomplete.errors import UserError
from recipes.train_embedded_prior.data.mesh_pack import read_manifest, read_mesh
from tests.builders.mesh_pack import write_pack


def test_meshes_come_centred_with_their_colours(tmp_path):
    folder = write_pack(tmp_path / "pack")
    entries = {entry.id: entry for entry in read_manifest(folder)}
    mesh = read_mesh(folder, entries["a/red"])
    assert mesh.vertices.min(axis=0) == pytest.approx([-0.25, -0.25, -0.5], abs=1e-6)
    assert mesh.vertices.max(axis=0) == pytest.approx([0.25, 0.25, 0.5], abs=1e-6)
    middle = np.full((2, 3), 1 / 3, np.float32)
    assert mesh.colors_at(np.array([0, 11]), middle).tolist() == [[1, 0, 0], [0, 0, 1]]
    textured = read_mesh(folder, entries["a/picture"])
    colors = textured.colors_at(np.array([0, 1, 5]), np.eye(3, dtype=np.float32))
    assert colors == pytest.approx(np.array([[0, 1, 0], [0, 1, 0], [128 / 255] * 3]))


def test_what_is_no_pack_is_refused_in_one_line(tmp_path):
    with pytest.raises(UserError, match="manifest"):
        read_manifest(tmp_path)
    folder = write_pack(tmp_path / "pack")
    entry = read_manifest(folder)[0]
    (folder / "a" / "red.npz").write_bytes(b"no mesh")
    with pytest.raises(UserError, match=r"red\.npz"):
        read_mesh(folder, entry)
    (folder / "MANIFEST.tsv").write_text("id\tsplit\n")
    with pytest.raises(UserError, match="columns"):
        read_manifest(folder)
