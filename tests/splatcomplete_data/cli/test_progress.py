"""Progress goes to standard error, and only where a person looks."""

import json

import pytest

from splatcomplete_data import cli


@pytest.fixture
def ball(tmp_path):
    import trimesh

    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "ball.ply")
    return tmp_path / "ball.ply"


def test_mesh_with_json_prints_nothing_else(ball, tmp_path, capsys):
    out = tmp_path / "ball"
    code = cli.main(["mesh", str(ball), "--count", "2000", "--out", str(out), "--json"])
    printed = capsys.readouterr()
    assert code == 0
    assert json.loads(printed.out)["id"] == "ball"
    assert "\x1b" not in printed.err  # no bar where there is no terminal


@pytest.mark.parametrize("command", ["mesh", "scan"])
def test_stages_go_forward(ball, tmp_path, command):
    from splatcomplete_data.cli import mesh, scan

    shares: list[float] = []

    def enter(name: str, share: float) -> None:
        shares.append(share)

    if command == "mesh":
        mesh.make(mesh.MeshOptions(file=ball, count=500, cut=("plane:90",)), enter)
    else:
        scan.make(scan.ScanOptions(file=ball), enter)
    assert len(shares) >= 2
    assert shares == sorted(shares)
    assert 0 <= shares[0] < shares[-1] < 1
