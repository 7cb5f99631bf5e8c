"""Scans of every format give the same points; broken ones give one message."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from gscomplete.errors import UserError
from splatcomplete_data.scan.read import read_scan

POINTS = np.array([[0, 0, 0], [1, 2, 3], [-1, 0.5, 2], [np.nan, 0, 0]])
COLORS = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [9, 9, 9]], np.uint8)


def write_ply(path: Path, color: str = "uchar", faces: str = "") -> None:
    header = f"ply\nformat ascii 1.0\nelement vertex {len(POINTS)}\n"
    header += "".join(f"property double {axis}\n" for axis in "xyz")
    header += "".join(f"property {color} {name}\n" for name in ("red", "green", "blue"))
    rows = []
    for point, rgb in zip(POINTS, COLORS, strict=True):
        values = rgb / 255 if color == "float" else rgb
        rows.append(" ".join(map(str, [*point, *values])))
    path.write_text(header + faces + "end_header\n" + "\n".join(rows) + "\n")


@pytest.mark.parametrize(
    "kind", ["ply", "ply_float", "ply_int", "xyz", "xyz_unit", "xyz_wide", "las"]
)
def test_every_format_gives_the_finite_points_and_colours(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"a.{kind.split('_')[0]}"
    finite = POINTS[:3]
    if kind.startswith("ply"):
        write_ply(path, {"ply_float": "float", "ply_int": "int"}.get(kind, "uchar"))
    elif kind.startswith("xyz"):
        factor = {"xyz_unit": 1 / 255, "xyz_wide": 257}.get(kind, 1)
        colors = COLORS.astype(np.float64) * factor
        rows = np.concatenate([POINTS, colors], axis=1)
        path.write_text("# x y z r g b\n" + "\n".join(" ".join(map(str, row)) for row in rows))
    else:
        laspy = pytest.importorskip("laspy")
        las = laspy.create(point_format=2, file_version="1.2")
        las.header.scales = np.full(3, 0.001)
        las.x, las.y, las.z = finite.T
        las.red, las.green, las.blue = (COLORS[:3].astype(np.uint16) * 257).T
        las.write(str(path))
    scan = read_scan(path)
    np.testing.assert_allclose(scan.cloud.points, finite, atol=1e-6)
    np.testing.assert_allclose(scan.cloud.colors, COLORS[:3] / 255, atol=1e-6)
    if kind != "las":
        assert scan.rows == 4


@pytest.mark.filterwarnings("error")
def test_signalling_nans_count_as_any_others(tmp_path: Path) -> None:
    values = np.ones((3, 6), "<f4")
    values.view("<u4")[0, 0] = values.view("<u4")[1, 3] = 0x7FA00000  # an x and a red
    names = ("x", "y", "z", "red", "green", "blue")
    properties = "".join(f"property float {name}\n" for name in names)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex 3\n{properties}end_header\n"
    (tmp_path / "a.ply").write_bytes(header.encode() + values.tobytes())
    scan = read_scan(tmp_path / "a.ply")
    assert scan.rows == 3
    assert (scan.cloud.points == 1.0).all()
    assert scan.cloud.colors.tolist() == [[0.0, 1.0, 1.0], [1.0, 1.0, 1.0]]


def test_scan_meshes_are_sampled(tmp_path: Path) -> None:
    box = trimesh.creation.box((1, 1, 1))
    box.visual.vertex_colors = np.tile([200, 100, 0, 255], (8, 1)).astype(np.uint8)
    box.export(tmp_path / "room.ply")
    scan = read_scan(tmp_path / "room.ply")
    assert len(scan.cloud) > 100_000
    assert np.abs(scan.cloud.points).max() <= 0.5 + 1e-6
    np.testing.assert_allclose(scan.cloud.colors[0], np.array([200, 100, 0]) / 255, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.ply", b""),
        ("a.ply", b"solid\n"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nend_header\n1\n"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n"),
        ("a.xyz", b"1 2\n"),
        ("a.xyz", b"1 2 three\n4 5 6\n"),
        ("a.xyz", b"nan nan nan\n"),
        ("a.las", b"LASF" + bytes(300)),
        ("a.laz", b"nothing"),
        ("a.e57", b"1"),
    ],
)
def test_broken_scans_are_user_errors(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UserError, match=name):
        read_scan(tmp_path / name)
    with pytest.raises(UserError, match=r"none\.ply"):
        read_scan(tmp_path / "none.ply")


def test_scan_meshes_far_from_the_origin_stay_there(tmp_path: Path) -> None:
    box = trimesh.creation.box((1, 1, 1))
    far = np.array([500_000.0, 5_300_000.0, 300.0])
    box.apply_translation(far)
    box.export(tmp_path / "room.obj", digits=8)
    points = read_scan(tmp_path / "room.obj").cloud.points
    # float32 about the middle
    np.testing.assert_allclose(points.min(axis=0), far - 0.5, rtol=0, atol=1e-6)
    np.testing.assert_allclose(points.max(axis=0), far + 0.5, rtol=0, atol=1e-6)
    assert len(np.unique(points[:, 1])) > 1000


def test_a_colour_that_is_not_finite_darkens_no_other(tmp_path: Path) -> None:
    rows = [[0, 0, 0, 1.0, 0.5, 0.0], [1, 0, 0, np.inf, np.nan, 0.25]]
    (tmp_path / "a.xyz").write_text("\n".join(" ".join(map(str, row)) for row in rows))
    colors = read_scan(tmp_path / "a.xyz").cloud.colors
    np.testing.assert_allclose(colors, [[1.0, 0.5, 0.0], [0.0, 0.0, 0.25]])


def test_a_laz_with_more_chunks_than_bytes_is_refused(tmp_path: Path) -> None:
    """Its decoder makes room for what the table says, and ends the process."""
    laspy = pytest.importorskip("laspy")
    las = laspy.create(point_format=2, file_version="1.2")
    las.x = las.y = las.z = np.arange(50.0)
    las.write(str(tmp_path / "a.laz"))
    assert len(read_scan(tmp_path / "a.laz").cloud) == 50
    raw = bytearray((tmp_path / "a.laz").read_bytes())
    start = int.from_bytes(raw[96:100], "little")
    table = int.from_bytes(raw[start : start + 8], "little")
    raw[table + 4 : table + 8] = b"\xff\xff\xff\x7f"
    (tmp_path / "a.laz").write_bytes(raw)
    with pytest.raises(UserError, match="table of chunks: expected at most"):
        read_scan(tmp_path / "a.laz")
