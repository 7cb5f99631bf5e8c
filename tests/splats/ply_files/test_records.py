"""Records to splats and back: the compiled loops against numpy's bits and a float64 twin."""

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.splats import Splats, load_splats, read_splats
from gscomplete.splats.ply import write_splats
from gscomplete.splats.ply_files.header import Element, PlyError, Property
from gscomplete.splats.ply_files.layout import SplatLayout, find_layout
from gscomplete.splats.ply_files.records import Decoder, Encoder
from gscomplete.splats.ply_files.threads import blocks, for_each_block
from tests.builders.objects import random_splats

ODD = np.array([0.0, -0.0, np.nan, np.inf, -np.inf, 1e38, -1e38, 1e-40, 88.0, -104.0], np.float32)

FEW_ROWS = "gscomplete.splats.ply_files.records.FEW_ROWS"
BLOCK_BYTES = "gscomplete.splats.ply_files.threads.BLOCK_BYTES"


def make_layout(rest: int, seed: int, foreign: int = 2) -> tuple[SplatLayout, np.dtype]:
    """Properties in an order drawn by ``seed``, foreign ones among them."""
    names = [*schema_names(rest), *(f"extra_{i}" for i in range(foreign))]
    order = np.random.default_rng(seed).permutation(len(names))
    element = Element("vertex", 0, tuple(Property(names[i], "f4") for i in order), 0)
    return find_layout(element, Path("a.ply")), element.row_dtype("=")


def schema_names(rest: int) -> list[str]:
    names = [*"xyz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(rest))]
    return [*names, "opacity", "scale_0", "scale_1", "scale_2", *(f"rot_{i}" for i in range(4))]


def decode(records: np.ndarray, layout: SplatLayout) -> Splats:
    decoder = Decoder.for_rows(len(records), layout, records.dtype)
    for rows in blocks(len(records), records.itemsize * 7):
        decoder.fill(rows, records[rows])
    return decoder.splats()


def extreme_splats(count: int, degree: int, seed: int = 0) -> Splats:
    rng = np.random.default_rng(seed)
    opacities = rng.random(count)
    opacities[:3] = 0, 1, 1e-30
    scales = np.exp(rng.normal(-4, 3, (count, 3)))
    scales[0] = 0, 1e-44, 1e30
    values = (rng.normal(size=(count, 3)), rng.normal(size=(count, 4)), scales, opacities)
    sh = rng.normal(size=(count, (degree + 1) ** 2, 3))
    return Splats(*(torch.from_numpy(v.astype(np.float32)) for v in (*values, sh)))


@settings(max_examples=20, deadline=None)
@given(rest=st.sampled_from([0, 9, 24, 45, 72]), seed=st.integers(0, 999), data=st.data())
def test_compiled_decoding_gives_the_bits_of_numpy(rest, seed, data):
    layout, dtype = make_layout(rest, seed)
    rng = np.random.default_rng(seed)
    table = rng.normal(scale=5, size=(300, len(dtype.names))).astype(np.float32)
    hit = rng.random(table.shape) < data.draw(st.sampled_from([0.0, 0.2, 0.9]))
    table[hit] = rng.choice(ODD, int(hit.sum()))
    records = table.view(dtype)[:, 0]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FEW_ROWS, -1)
        compiled = decode(records, layout)
    plain = decode(records, layout)
    for (name, fast), (_, slow) in zip(compiled.fields(), plain.fields(), strict=True):
        np.testing.assert_array_equal(fast.numpy(), slow.numpy(), err_msg=name)
        finite = ~np.isnan(slow.numpy())
        bits = fast.numpy()[finite].view(np.uint32), slow.numpy()[finite].view(np.uint32)
        np.testing.assert_array_equal(*bits, err_msg=name)


def test_compiled_decoding_against_float64(monkeypatch):
    monkeypatch.setattr(FEW_ROWS, -1)
    layout, dtype = make_layout(45, 3)
    table = np.random.default_rng(1).normal(size=(40, len(dtype.names))).astype(np.float32)
    splats = decode(table.view(dtype)[:, 0], layout)
    for i, row in enumerate(table.astype(np.float64)):
        quaternion = np.array([row[j] for j in layout.quaternion])
        expected = {
            "means": [row[j] for j in layout.means],
            "quaternions": quaternion / np.linalg.norm(quaternion),
            "scales": [np.exp(row[j]) for j in layout.scales],
            "opacities": 1 / (1 + np.exp(-row[layout.opacity])),
            "sh": np.reshape([row[j] for j in layout.sh], (16, 3)),
        }
        for name, value in expected.items():
            found = getattr(splats, name)[i].numpy()
            np.testing.assert_allclose(found, value, rtol=1e-6, err_msg=name)


@settings(max_examples=20, deadline=None)
@given(rest=st.sampled_from([0, 9, 24, 45, 72]), seed=st.integers(0, 999), data=st.data())
def test_compiled_encoding_gives_the_bytes_of_numpy(rest, seed, data):
    layout, dtype = make_layout(rest, seed, foreign=data.draw(st.sampled_from([0, 3])))
    degree = data.draw(st.integers(0, {0: 0, 9: 1, 24: 2, 45: 3, 72: 3}[rest]))
    splats = extreme_splats(500, degree, seed)
    plain = Encoder.of_splats(splats, layout, dtype)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FEW_ROWS, -1)
        compiled = Encoder.of_splats(splats, layout, dtype)
    assert compiled.compiled
    assert not plain.compiled
    for rows in (slice(0, 300), slice(300, 500), slice(10, 30)):
        assert compiled.records(rows).tobytes() == plain.records(rows).tobytes()


@pytest.mark.parametrize("degree", [0, 3])
def test_large_files_come_back_through_the_compiled_loops(tmp_path, degree):
    splats = extreme_splats(20_000, degree)
    write_splats(tmp_path / "a.ply", splats)
    loaded, file = load_splats(tmp_path / "a.ply"), read_splats(tmp_path / "a.ply")
    for (name, wrote), (_, read) in zip(splats.fields(), loaded.fields(), strict=True):
        expected = torch.nn.functional.normalize(wrote) if name == "quaternions" else wrote
        assert torch.allclose(expected, read, rtol=3e-5, atol=1e-6), name
        assert torch.equal(read, getattr(file.splats, name)), name
    assert file.payload.records.tobytes() == (tmp_path / "a.ply").read_bytes()[file.header.size :]


def test_loading_refuses_what_reading_refuses(tmp_path):
    write_splats(tmp_path / "a.ply", extreme_splats(9000, 0))
    content = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(content[:-1])
    with pytest.raises(PlyError, match="truncated"):
        load_splats(tmp_path / "a.ply")


def test_a_bad_value_in_a_large_set_leaves_the_old_file(tmp_path):
    splats = extreme_splats(60_000, 0)
    splats.opacities[30_000] = 2.0
    splats.opacities[59_999] = float("nan")
    (tmp_path / "a.ply").write_bytes(b"old")
    with pytest.raises(ValueError, match=r"expected values in \[0, 1\]"):
        write_splats(tmp_path / "a.ply", splats)
    assert (tmp_path / "a.ply").read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


@settings(max_examples=30, deadline=None)
@given(count=st.integers(0, 5000), row_size=st.integers(1, 4000), threads=st.integers(1, 4))
def test_every_row_is_visited_once_and_the_first_failure_is_raised(count, row_size, threads):
    visits = np.zeros(count, np.int64)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BLOCK_BYTES, 10_000)
        patch.setattr("numba.config.NUMBA_NUM_THREADS", threads)

        def visit(rows: slice) -> None:
            visits[rows] += 1

        def fail(rows: slice) -> None:
            if rows.stop > count // 2:
                raise ValueError(rows.start)

        for_each_block(count, row_size, visit)
        assert (visits == 1).all()
        if count:
            first = next(rows.start for rows in blocks(count, row_size) if rows.stop > count // 2)
            with pytest.raises(ValueError, match=f"^{first}$"):
                for_each_block(count, row_size, fail)


def test_values_beyond_float32_are_refused_not_written_as_infinities(tmp_path):
    splats = random_splats(3)
    means = splats.means.double().clone()
    means[1, 2] = 1e300
    double = Splats(**{name: value.double() for name, value in splats.fields()} | {"means": means})
    with pytest.raises(ValueError, match="float32"):
        write_splats(tmp_path / "a.ply", double)
    assert not (tmp_path / "a.ply").exists()
