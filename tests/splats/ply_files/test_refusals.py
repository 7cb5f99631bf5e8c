"""Files that are no splats, damaged, cut short or mutated: refused with a clear error, or read."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gscomplete.errors import UserError
from gscomplete.splats import PlyError, append_splats, read_splats
from gscomplete.splats.validation import validate_file
from tests.builders.objects import random_splats
from tests.builders.ply_files import FORMATS, make_ply, random_table, schema

DATA = (Path(__file__).resolve().parents[3] / "../shared/data").resolve()
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="shared/data is absent")


BAD = {
    "empty": (b"", "not_a_splat_file", "an empty file"),
    "gzip": (gzip.compress(b"x", mtime=0), "not_a_splat_file", "gzip"),
    "spz": (b"NGSP\x04\0\0\0", "not_a_splat_file", "SPZ"),
    "html": (b"<!DOCTYPE html><html>", "not_a_splat_file", "HTML"),
    "lfs": (b"version https://git-lfs.github.com/spec/v1\n", "not_a_splat_file", "git-lfs"),
    "zeros": (bytes(100), "not_a_splat_file", "zero bytes"),
    "no end": (b"ply\nformat ascii 1.0\nelement vertex 1\n", "bad_header", "end_header"),
    "no format": (b"ply\nelement vertex 1\nend_header\n", "bad_header", "format"),
    "format": (b"ply\nformat middle 1.0\nend_header\n", "bad_header", "line 2"),
    "count": (b"ply\nformat ascii 1.0\nelement vertex -1\nend_header\n", "bad_header", "line 3"),
    "type": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty half x\nend_header\n",
        "bad_header",
        "known type",
    ),
    "no vertex": (
        b"ply\nformat ascii 1.0\nelement face 0\nend_header\n",
        "not_a_splat_file",
        "elements: face",
    ),
}

PACKED = b"ply\nformat ascii 1.0\nelement vertex 0\nproperty uint packed_position\nend_header\n"


@pytest.mark.parametrize("name", BAD)
def test_bad_files(tmp_path, name):
    content, finding, message = BAD[name]
    path = tmp_path / "bad.ply"
    path.write_bytes(content)
    with pytest.raises(PlyError, match=message) as caught:
        read_splats(path)
    assert caught.value.finding == finding
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.compressed.ply", PACKED),
        ("a.spz", b"NGSP\x04\0\0\0"),
        ("a.spz", gzip.compress(b"x", mtime=0)),
        ("a.splat", bytes(32)),
    ],
)
def test_files_that_this_package_converts_say_how(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    suffix = name.removeprefix("a")
    with pytest.raises(PlyError, match=f"splatcomplete-data convert IN{suffix} OUT.ply"):
        read_splats(tmp_path / name)


def test_missing_file_and_folder(tmp_path):
    for path in (tmp_path / "absent.ply", tmp_path):
        with pytest.raises(PlyError) as caught:
            read_splats(path)
        assert caught.value.finding == "unreadable_file"


def without(name: str) -> dict[str, np.ndarray]:
    table = random_table(2, 45)
    del table[name]
    return table


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("cow.obj", b"\nmtllib cow.mtl\nv 0 0 0\n"),
        (
            "mesh.ply",
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nelement face 1\n"
            b"property list uchar int vertex_indices\nend_header\n0\n3 0 0 0\n",
        ),
    ],
)
def test_meshes_say_what_makes_splats_of_them(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(PlyError, match="splatcomplete-data mesh FILE"):
        read_splats(tmp_path / name)


@pytest.mark.parametrize("name", ["x", "opacity", "f_dc_1", "scale_2", "rot_0", "f_rest_7"])
def test_missing_property_is_named(tmp_path, name):
    (tmp_path / "a.ply").write_bytes(make_ply(without(name)))
    with pytest.raises(PlyError, match=name) as caught:
        read_splats(tmp_path / "a.ply")
    assert caught.value.finding == "missing_property"


def test_wrong_sh_count_and_list_property(tmp_path):
    (tmp_path / "a.ply").write_bytes(make_ply(without("f_rest_44")))
    with pytest.raises(PlyError, match="found 44") as caught:
        read_splats(tmp_path / "a.ply")
    assert caught.value.finding == "sh_layout"
    raw = make_ply(random_table(2, 0)).replace(b"float opacity", b"list uchar float opacity")
    (tmp_path / "a.ply").write_bytes(raw)
    with pytest.raises(PlyError, match="opacity") as caught:
        read_splats(tmp_path / "a.ply")
    assert caught.value.finding == "mistyped_property"


@pytest.mark.parametrize("form", FORMATS)
def test_truncated_payload(tmp_path, form):
    raw = make_ply(random_table(50, 0), form)
    (tmp_path / "a.ply").write_bytes(raw[: len(raw) - 700])
    with pytest.raises(PlyError, match=r"expected.*found") as caught:
        read_splats(tmp_path / "a.ply")
    assert caught.value.finding == "truncated_payload"


@pytest.mark.parametrize("form", FORMATS)
def test_absurd_count_allocates_nothing(tmp_path, form):
    raw = make_ply(random_table(2, 0), form)
    raw = raw.replace(b"vertex 2", b"vertex 999999999999999")
    (tmp_path / "a.ply").write_bytes(raw)
    with pytest.raises(PlyError) as caught:
        read_splats(tmp_path / "a.ply")
    assert caught.value.finding == "truncated_payload"


MUTATIONS = st.lists(
    st.one_of(
        st.tuples(st.just("cut"), st.integers(0, 3000), st.integers(0, 300)),
        st.tuples(st.just("set"), st.integers(0, 3000), st.integers(0, 255)),
        st.tuples(
            st.just("put"),
            st.integers(0, 800),
            st.sampled_from(
                [
                    b"\n", b"\r", b"\0", b"end_header\n", b"list uchar ", b"99999999999", b"-1",
                    b"element vertex 3\n", b"property float x\n", b"nan ", b"1e999 ", b"comment ",
                    b"element z 9\nproperty list int int q\n", b"\xff\xfe", b"format ascii 1.0\n",
                ]
            ),
        ),
    ),
    min_size=1,
    max_size=4,
)  # fmt: skip


@pytest.mark.parametrize("form", FORMATS)
@settings(max_examples=120, deadline=None, suppress_health_check=list(HealthCheck))
@given(mutations=MUTATIONS)
def test_mutated_files_read_or_give_a_user_error(tmp_path, form, mutations):
    raw = make_ply(random_table(8, 9), form, after=("element e 1\nproperty uchar u\n", b"1"))
    for kind, place, value in mutations:
        if kind == "cut":
            raw = raw[:place] + raw[place + value :]
        elif kind == "put":
            raw = raw[:place] + value + raw[place:]
        elif place < len(raw):
            raw = raw[:place] + bytes([value]) + raw[place + 1 :]
    (tmp_path / "m.ply").write_bytes(raw)
    try:
        file = read_splats(tmp_path / "m.ply")
    except UserError:
        return
    if not any("integer" in warning for warning in file.warnings):
        append_splats(tmp_path / "n.ply", file, random_splats(1))
        assert read_splats(tmp_path / "n.ply").n_rows == file.n_rows + 1


@pytest.mark.parametrize("byte", [0xA0, 0x85, 0x1C, 0x00, 0xFF])
def test_what_is_no_ascii_is_refused_by_reading_and_validating(tmp_path, byte):
    """NumPy splits rows at the byte 0xA0 of Latin-1, ``bytes.split`` does not."""
    properties = "".join(f"property float {name}\n" for name in schema(0))
    row = b"1 " * (len(schema(0)) - 1) + b"1\n"
    head = f"ply\nformat ascii 1.0\nelement vertex 2\n{properties}end_header\n".encode()
    (tmp_path / "a.ply").write_bytes(head + row + row.replace(b" ", bytes([byte]), 1))
    message = f"row 1: expected ASCII, found byte 0x{byte:02X}"
    with pytest.raises(PlyError, match=message):
        read_splats(tmp_path / "a.ply")
    (finding,) = validate_file(tmp_path / "a.ply").findings
    assert message in finding.message


@needs_data
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("splats/playcanvas/biker.compressed.ply", "SuperSplat compressed"),
        ("splats/playcanvas/biker.spz", "SPZ"),
        ("splats/brush/init.ply", "coloured point cloud"),
        ("lidar/cupoch_redwood/frag_115.ply", "mesh PLY"),
        ("multiview/snowmiku_plush/sparse/0/points3D.ply", "coloured point cloud"),
        ("splats/splat-transform-fixtures/splat/minimal.splat", ".splat"),
    ],
)
def test_real_files_that_are_not_splats(name, message):
    with pytest.raises(PlyError, match=message):
        read_splats(DATA / name)
