"""PCD files of every kind give the same points; broken ones give a message."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gscomplete.errors import UserError
from splatcomplete_data.scan import GREY, lzf_decompress, read_pcd
from splatcomplete_data.scan.read import NO_COLOR, read_scan

DATA = Path(__file__).resolve().parents[3] / "../shared/data"
RECORD = np.dtype([("label", "<u4"), ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgba", "<u4")])


def example() -> np.ndarray:
    rows = np.zeros(4, RECORD)
    rows["label"] = [1, 20, 30, 31]
    for axis, values in zip("xyz", ([1, 2, 3, np.nan], [4, 5, 6, 0], [7, 8, 9, 0]), strict=True):
        rows[axis] = values
    rows["rgba"] = [0xFFFF0000, 0xFF00FF00, 0x000000FF, 0]
    return rows


def literal_lzf(data: bytes) -> bytes:
    """Store bytes as LZF literals only."""
    blocks = [data[i : i + 32] for i in range(0, len(data), 32)]
    return b"".join(bytes([len(block) - 1]) + block for block in blocks)


def pcd_bytes(rows: np.ndarray, data: str) -> bytes:
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS label x y z rgba\n"
        f"SIZE 4 4 4 4 4\nTYPE U F F F U\nCOUNT 1 1 1 1 1\nWIDTH {len(rows)}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA {data}\n"
    ).encode()
    if data == "ascii":
        return header + "\n".join(" ".join(str(value) for value in row) for row in rows).encode()
    if data == "binary":
        return header + rows.tobytes()
    plain = b"".join(np.ascontiguousarray(rows[name]).tobytes() for name in RECORD.names or ())
    packed = literal_lzf(plain)
    return header + np.array([len(packed), len(plain)], "<u4").tobytes() + packed


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
def test_every_encoding_gives_the_points(tmp_path: Path, data: str) -> None:
    path = tmp_path / "a.pcd"
    path.write_bytes(pcd_bytes(example(), data))
    found = read_pcd(path)
    assert found.is_colored
    cloud = found.cloud.select(np.isfinite(found.cloud.points).all(axis=1))
    assert len(found.cloud) > len(cloud)
    np.testing.assert_array_equal(cloud.points, [[1, 4, 7], [2, 5, 8], [3, 6, 9]])
    np.testing.assert_array_equal(cloud.colors, np.eye(3))
    assert cloud.labels is not None
    assert cloud.labels.tolist() == [1, 20, 30]
    assert read_scan(path).rows == len(found.cloud)


def test_points_without_colour_are_grey(tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    path.write_text(
        "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n1 2 3\n"
    )
    found = read_pcd(path)
    np.testing.assert_allclose(found.cloud.colors, GREY)
    assert not found.is_colored
    assert found.cloud.labels is None
    assert read_scan(path).notes == (NO_COLOR,)


def test_channels_may_be_fields_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    path.write_text(
        "FIELDS x y z r g b\nSIZE 4 4 4 1 1 1\nTYPE F F F U U U\nWIDTH 1\nHEIGHT 1\nPOINTS 1\n"
        "DATA ascii\n1 2 3 255 51 0\n"
    )
    np.testing.assert_allclose(read_pcd(path).cloud.colors, [[1.0, 0.2, 0.0]])


def slow_lzf(packed: bytes) -> bytes:
    """Byte by byte, as the format is described."""
    out: list[int] = []
    source = iter(packed)
    for control in source:
        if control < 32:
            out.extend(next(source) for _ in range(control + 1))
            continue
        length = control >> 5
        if length == 7:
            length += next(source)
        distance = ((control & 31) << 8) + next(source) + 1
        for _ in range(length + 2):
            out.append(out[-distance])
    return bytes(out)


@st.composite
def lzf_streams(draw: st.DrawFn) -> bytes:
    """Valid streams of literals and back references."""
    stream, size = bytearray(), 0
    for _ in range(draw(st.integers(1, 12))):
        if size == 0 or draw(st.booleans()):
            literal = draw(st.binary(min_size=1, max_size=32))
            stream += bytes([len(literal) - 1]) + literal
            size += len(literal)
            continue
        distance = draw(st.integers(1, min(size, 8192))) - 1
        length = draw(st.integers(3, 264))
        code = min(length - 2, 7)
        stream += bytes([(code << 5) | (distance >> 8)])
        stream += bytes([length - 9]) if code == 7 else b""
        stream += bytes([distance & 255])
        size += length
    return bytes(stream)


@given(lzf_streams())
def test_lzf_equals_its_slow_twin(stream: bytes) -> None:
    expected = slow_lzf(stream)
    assert lzf_decompress(stream, len(expected)) == expected
    with pytest.raises(ValueError, match="expected"):
        lzf_decompress(stream, len(expected) + 1)


@given(
    st.sampled_from(["ascii", "binary", "binary_compressed"]),
    st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=4),
    st.integers(0, 400),
)
@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_damaged_files_give_a_message_or_points(
    tmp_path: Path, data: str, changes: list[tuple[int, int]], length: int
) -> None:
    raw = bytearray(pcd_bytes(example(), data))
    for place, value in changes:
        raw[place % len(raw)] = value
    path = tmp_path / "damaged.pcd"
    path.write_bytes(raw if length > 200 else raw[: length + 60])
    try:
        cloud = read_scan(path).cloud
    except UserError:
        return
    assert np.isfinite(cloud.points).all()


def test_missing_file_is_a_user_error(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"none\.pcd"):
        read_pcd(tmp_path / "none.pcd")


def test_real_scan_has_its_objects() -> None:
    path = DATA / "lidar/pcl/mOSD/learn_learn0.pcd"
    if not path.is_file():
        pytest.skip("real data are not here (../shared/data)")
    cloud = read_scan(path).cloud
    assert len(cloud) == 182_292
    assert cloud.labels is not None
    assert sorted(set(cloud.labels // 10)) == [0, 2, 3]
    assert cloud.colors.std(axis=0).min() > 0.05


@pytest.mark.parametrize("down", [1, -1])
@pytest.mark.parametrize("forward", [1, -1])
def test_an_organised_cloud_is_a_picture_from_the_origin(tmp_path, down, forward):
    rows, columns = np.mgrid[:12, :16].astype(float)
    z = forward * np.random.default_rng(0).uniform(1, 2, rows.shape)
    points = np.stack([(columns - 8) / 20 * z, down * (rows - 6) / 20 * z, z], -1).reshape(-1, 3)
    points[5] = np.nan
    shape = "WIDTH 16\nHEIGHT 12"
    header = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n" + shape
    end = "\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 192\nDATA ascii"
    path = tmp_path / "a.pcd"
    np.savetxt(path, points, header=header + end, comments="")
    found = read_pcd(path)
    assert found.viewpoint == (0.0, 0.0, 0.0)
    assert found.up == ("-Y" if down * forward > 0 else "Y")
    np.savetxt(path, points[::-1][::2].repeat(2, axis=0), header=header + end, comments="")
    assert read_pcd(path).up is not None  # turned by half a circle, and coarser
    shuffled = np.random.default_rng(1).permutation(points)
    np.savetxt(path, shuffled, header=header + end, comments="")
    assert (read_pcd(path).viewpoint, read_pcd(path).up) == (None, None)
