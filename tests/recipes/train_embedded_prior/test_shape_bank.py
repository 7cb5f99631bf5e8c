from gscomplete.shape.bank.store import read_bank
from recipes.train_embedded_prior import shape_bank
from recipes.train_embedded_prior.shape_bank import Options
from tests.builders.mesh_pack import write_pack


def test_free_meshes_of_the_split_become_known_shapes(tmp_path, capsys):
    write_pack(tmp_path / "pack")
    out = tmp_path / "shapes.safetensors"
    shape_bank.main(Options(tmp_path / "pack", out, licences=("CC0",)))
    bank = read_bank(out)
    assert [name.id for name in bank.names] == ["a/red", "a/plain"]
    cells = bank.surface(0)
    # a box of .5 x .5 x 1 in a cube of 48 cells: hollow, and as wide as half its height
    filled = [int(cells.any(axis=axes).sum()) for axes in ((1, 2), (0, 2), (0, 1))]
    assert filled[2] == 48
    assert all(24 <= side <= 26 for side in filled[:2])
    assert not cells[20:28, 20:28, 10:38].any()
    assert "2 shapes" in capsys.readouterr().out
    shape_bank.main(
        Options(tmp_path / "pack", tmp_path / "none.safetensors", licences=("nothing",))
    )
    assert len(read_bank(tmp_path / "none.safetensors")) == 0
