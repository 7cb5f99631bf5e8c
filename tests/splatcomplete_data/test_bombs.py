"""A small file that says or holds too much is refused before it fills the memory."""

from __future__ import annotations

import base64
import gzip
import json
import struct
import subprocess
import sys
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.priors.latent.tensor_files import _read_torch
from gscomplete.splats.formats.any_file import read_any_splats, write_any_splats
from gscomplete.splats.formats.spz import check_spz_size
from splatcomplete_data.mesh.files.load import load_mesh
from splatcomplete_data.scan.pcd import lzf_decompress, read_pcd
from splatcomplete_data.singleview import depth_file
from splatcomplete_data.singleview.depth_file import read_depth
from tests.builders.commands import PATIENCE_S
from tests.builders.objects import ball

MIB = 2**20


def bomb_npz(path: Path, mib: int) -> Path:
    """An NPZ whose depth is zeros: a thousandth of its size on the disk."""
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("depth.npy", "w", force_zip64=True) as stream,
    ):
        header = {"descr": "<f4", "fortran_order": False, "shape": (mib * 1024, 256)}
        np.lib.format.write_array_header_1_0(stream, header)
        for _ in range(mib):
            stream.write(bytes(MIB))
    return path


def test_an_npz_that_unpacks_to_much_more_is_refused(tmp_path: Path) -> None:
    path = bomb_npz(tmp_path / "d.npz", 400)
    assert path.stat().st_size < MIB
    with pytest.raises(UserError, match=r"depth\.npy: expected at most .* found 400 MiB"):
        read_depth(path)


def test_a_depth_image_has_a_largest_size(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(depth_file, "MAX_PIXELS", 15)
    np.save(tmp_path / "d.npy", np.ones((4, 4), np.float32))
    with pytest.raises(UserError, match="at most 15 pixels, found 4 x 4"):
        read_depth(tmp_path / "d.npy")


def test_an_npy_that_says_more_than_it_holds_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "d.npy").open("wb") as stream:
        header = {"descr": "<f4", "fortran_order": False, "shape": (10**6, 10**6)}
        np.lib.format.write_array_header_1_0(stream, header)
    with pytest.raises(UserError, match="cannot read it as depth"):
        read_depth(tmp_path / "d.npy")


def spz_head(count: int, version: int = 3) -> bytes:
    return struct.pack("<4sIIBBBB", b"NGSP", version, count, 0, 12, 0, 0)


def test_an_spz_that_holds_more_than_its_splats_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.spz"
    path.write_bytes(gzip.compress(spz_head(10) + bytes(40 * MIB), 1))
    with pytest.raises(UserError, match=r"expected at most 1,048,792 bytes of 10 splats"):
        read_any_splats(path)
    # a second stream counts, too
    plain = gzip.compress(spz_head(10) + bytes(200))
    path.write_bytes(plain + gzip.compress(bytes(40 * MIB), 1))
    with pytest.raises(UserError, match="found more"):
        read_any_splats(path)
    path.write_bytes(plain)
    check_spz_size(path)


def test_an_spz_that_says_more_than_it_can_hold_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.spz"
    path.write_bytes(gzip.compress(spz_head(2**31)))
    with pytest.raises(UserError, match=r"2,147,483,648 splats: expected at most 256 MiB"):
        read_any_splats(path)


def test_spz_of_every_version_passes(tmp_path: Path) -> None:
    gsply = pytest.importorskip("gsply")
    write_any_splats(tmp_path / "a.spz", ball(500))
    check_spz_size(tmp_path / "a.spz")
    gsply.write_spz(tmp_path / "b.spz", gsply.read_spz(tmp_path / "a.spz"), version=4)
    check_spz_size(tmp_path / "b.spz")
    packed = bytearray((tmp_path / "b.spz").read_bytes())
    packed[8:12] = (3).to_bytes(4, "little")
    (tmp_path / "b.spz").write_bytes(packed)
    with pytest.raises(UserError, match="bytes a stream, found"):
        check_spz_size(tmp_path / "b.spz")


def test_unpacking_lzf_stops_where_it_is_too_much() -> None:
    packed = b"\x00a" + b"\xe0\xff\x00" * 10_000  # 264 bytes for each three
    with pytest.raises(ValueError, match="expected 100 bytes, found"):
        lzf_decompress(packed, 100)
    with pytest.raises(ValueError, match=r"found 26[0-9]$"):
        lzf_decompress(packed, 100)


@pytest.mark.parametrize("count", [10**9, 70_000, 0, -1])
def test_a_pcd_field_has_a_sane_number_of_values(tmp_path: Path, count: int) -> None:
    header = "FIELDS x y z f\nSIZE 4 4 4 4\nTYPE F F F F\n"
    text = f"{header}COUNT 1 1 1 {count}\nPOINTS 1\nDATA binary\n"
    (tmp_path / "a.pcd").write_bytes(text.encode() + bytes(100))
    with pytest.raises(UserError, match="COUNT: expected 1 to 65,536 values a field"):
        read_pcd(tmp_path / "a.pcd")


def test_a_gltf_without_data_is_refused(tmp_path: Path) -> None:
    zeros = base64.b64encode(bytes(12)).decode()
    data = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 12, "uri": f"data:application/octet-stream;base64,{zeros}"}],
        "accessors": [{"componentType": 5126, "count": 10**9, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    }
    (tmp_path / "a.gltf").write_text(json.dumps(data))
    with pytest.raises(UserError, match=r"accessors\[0\]: expected at most .*1,000,000,000"):
        load_mesh(tmp_path / "a.gltf")


def test_a_glb_that_says_its_json_is_huge_is_refused(tmp_path: Path) -> None:
    """A read of what the header says makes room for it first."""
    path = tmp_path / "a.glb"
    path.write_bytes(b"glTF" + struct.pack("<IIII", 2, 40, 2**32 - 1, 0x4E4F534A) + b"{}  ")
    tracemalloc.start()
    with pytest.raises(UserError):
        load_mesh(path)
    assert tracemalloc.get_traced_memory()[1] < 100 * MIB
    tracemalloc.stop()


@pytest.mark.parametrize("name", ["a.zip", "a.zae", "a.tar.gz", "a.bz2"])
def test_archives_are_no_meshes(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"PK\x03\x04")
    with pytest.raises(UserError, match=r"expected a mesh \(\.gltf, .*found suffix"):
        load_mesh(tmp_path / name)


def test_weights_in_a_compressed_archive_are_refused(tmp_path: Path) -> None:
    torch.save({"a": torch.zeros(1000)}, tmp_path / "a.pt")
    assert "a" in _read_torch(tmp_path / "a.pt")
    with (
        zipfile.ZipFile(tmp_path / "a.pt") as source,
        zipfile.ZipFile(tmp_path / "b.pt", "w", zipfile.ZIP_DEFLATED) as target,
    ):
        for name in source.namelist():
            target.writestr(name, source.read(name))
    with pytest.raises(UserError, match="members are compressed"):
        _read_torch(tmp_path / "b.pt")


def test_a_bomb_is_refused_in_little_memory(tmp_path: Path) -> None:
    bomb_npz(tmp_path / "d.npz", 400)
    code = (
        "import resource, sys; from pathlib import Path\n"
        "from gscomplete.errors import UserError\n"
        "from splatcomplete_data.singleview.depth_file import read_depth\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "try: read_depth(Path(sys.argv[1]))\n"
        "except UserError: print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "d.npz")]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=PATIENCE_S)
    assert int(done.stdout) < 100_000  # kB
