"""Each finding of the validation, raised by a file that has just that fault."""

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gscomplete.splats import Splats, write_splats
from gscomplete.splats.formats.compressed_ply import read_compressed_ply
from gscomplete.splats.row_statistics import COUNTS, hash_rows
from gscomplete.splats.validation import ValidationReport, validate_file

DATA = (Path(__file__).resolve().parents[2] / "../shared/data").resolve()
NAMES = [*"xyz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
NAMES += [f"rot_{i}" for i in range(4)]


def sound_table(count: int = 500, rest: int = 0, seed: int = 0) -> dict[str, np.ndarray]:
    """Values as of a small trained object."""
    rng = np.random.default_rng(seed)
    names = [*NAMES[:6], *(f"f_rest_{i}" for i in range(rest)), *NAMES[6:]]
    table = {name: rng.normal(size=count).astype("<f4") for name in names}
    for i, axis in enumerate("xyz"):
        table[axis] = rng.uniform(-2, 2, count).astype("<f4")
        table[f"scale_{i}"] = table[f"scale_{i}"] * 0.3 - 4
    quaternions = np.stack([table[f"rot_{i}"] for i in range(4)])
    for i, column in enumerate(quaternions / np.linalg.norm(quaternions, axis=0)):
        table[f"rot_{i}"] = column
    return table


def check(tmp_path: Path, table: dict[str, np.ndarray], kind: str = "float") -> ValidationReport:
    count = len(table["x"])
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    lines += [f"property {kind} {name}" for name in table]
    body = np.stack(list(table.values()), axis=1).astype({"float": "<f4", "uchar": "u1"}[kind])
    path = tmp_path / "a.ply"
    path.write_bytes("\n".join([*lines, "end_header", ""]).encode() + body.tobytes())
    return validate_file(path)


def named(report: ValidationReport) -> dict[str, tuple[str, int]]:
    return {finding.name: (finding.severity, finding.count) for finding in report.findings}


@pytest.mark.parametrize("rest", [0, 9, 24, 45])
def test_a_sound_file_has_no_findings(tmp_path, rest):
    report = check(tmp_path, sound_table(rest=rest))
    assert (report.ok, report.findings, report.n_splats) == (True, (), 500)
    assert report.sh_degree == {0: 0, 9: 1, 24: 2, 45: 3}[rest]
    assert report.bounds is not None


def test_own_files_have_no_findings_up_to_info(tmp_path):
    generator = torch.Generator().manual_seed(0)
    count = 200
    splats = Splats(
        torch.rand(count, 3, generator=generator),
        torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
        torch.full((count, 3), 0.01),
        torch.full((count,), 0.7),
        torch.zeros(count, 1, 3),
    )
    write_splats(tmp_path / "a.ply", splats)
    assert validate_file(tmp_path / "a.ply").findings == ()


VALUES = {
    "nan": ("f_dc_1", np.nan, "error"),
    "infinite": ("x", np.inf, "error"),
    "infinite_opacity": ("opacity", np.inf, "warning"),
    "infinite_scale": ("scale_2", -np.inf, "warning"),
    "too_large": ("y", 1e25, "warning"),
}


@pytest.mark.parametrize("name", VALUES)
def test_odd_values_are_counted(tmp_path, name):
    field, value, severity = VALUES[name]
    table = sound_table()
    table[field][[3, 77]] = value
    found = named(check(tmp_path, table))
    assert found[name] == (severity, 2)
    assert set(found) <= {name, "position_outliers"}


@pytest.mark.parametrize(("field", "value"), [("scale_1", np.inf), ("opacity", -np.inf),
                                              ("f_rest_4", np.inf)])  # fmt: skip
def test_other_infinities_are_errors(tmp_path, field, value):
    table = sound_table(rest=9)
    table[field][5] = value
    assert named(check(tmp_path, table)) == {"infinite": ("error", 1)}


def test_nan_in_higher_harmonics(tmp_path):
    table = sound_table(rest=9)
    table["f_rest_8"][5] = np.nan
    assert named(check(tmp_path, table)) == {"nan": ("error", 1)}


def test_all_nan(tmp_path):
    table = {name: np.full(9, np.nan) for name in NAMES}
    report = check(tmp_path, table)
    assert report.bounds is None
    assert named(report)["nan"] == ("error", 9)


def test_quaternions_zero_rows_and_duplicates(tmp_path):
    table = sound_table()
    for i in range(4):
        table[f"rot_{i}"][10:13] = 0
        table[f"rot_{i}"][20:25] *= 3
    for column in table.values():
        column[30:34] = 0
        column[41] = column[42] = column[40]
    found = named(check(tmp_path, table))
    assert found == {
        "zero_quaternions": ("error", 7),
        "unnormalised_quaternions": ("info", 5),
        "zero_rows": ("warning", 4),
        "giants": ("warning", 4),  # a logarithm of 0 is a size of 1
        "duplicates": ("warning", 2),
    }


def test_values_that_were_not_converted(tmp_path):
    table = sound_table()
    rng = np.random.default_rng(1)
    table["opacity"] = rng.random(500)
    for i in range(3):
        table[f"scale_{i}"] = rng.random(500) * 0.02
        table[f"f_dc_{i}"] = rng.random(500)
    report = check(tmp_path, table)
    assert not report.ok
    found = named(report)
    assert found["linear_opacity"][0] == found["linear_scale"][0] == "error"
    assert found["linear_color"][0] == "warning"
    table["f_dc_0"] *= 255
    assert "linear_color" in named(check(tmp_path, table))


def test_narrow_opacities_only_hint(tmp_path):
    table = sound_table()
    table["opacity"] = 0.4 + 0.3 * np.random.default_rng(1).random(500)
    assert named(check(tmp_path, table))["linear_opacity"][0] == "warning"


def test_coefficient_major_harmonics(tmp_path):
    rng = np.random.default_rng(2)
    grey = rng.normal(size=(500, 15, 1))
    sh = grey + 0.3 * rng.normal(size=(500, 15, 3))  # coefficient, channel
    table = sound_table(rest=45)
    for order, expected in ((sh.transpose(0, 2, 1), False), (sh, True)):
        for i, column in enumerate(order.reshape(500, 45).T):
            table[f"f_rest_{i}"] = column
        assert ("sh_layout" in named(check(tmp_path, table))) == expected


def test_wrong_harmonics_count(tmp_path):
    table = sound_table(rest=44)
    assert named(check(tmp_path, table))["sh_layout"][0] == "error"


def test_files_of_which_nothing_can_be_seen_are_errors(tmp_path):
    faint = sound_table()
    faint["opacity"][:] = -6.0
    assert named(check(tmp_path, faint))["invisible"] == ("error", 500)
    faint["opacity"][7] = -5.0
    assert "invisible" not in named(check(tmp_path, faint))
    huge = sound_table()
    huge["x"][:] = 1e25
    assert named(check(tmp_path, huge))["not_drawable"] == ("error", 500)
    huge["x"][0] = 0.0
    assert "not_drawable" not in named(check(tmp_path, huge))


def test_outliers_and_frames(tmp_path):
    table = sound_table()
    table["x"][:2] = 1e4
    table["scale_0"][:3] = 5
    found = named(check(tmp_path, table))
    assert found["position_outliers"] == ("warning", 2)
    assert found["giants"] == ("warning", 3)
    far = sound_table()
    far["z"] += 1e5
    assert set(named(check(tmp_path, far))) >= {"far_from_origin"}
    for factor, name in ((1e-6, "unusual_extent"), (1e6, "unusual_extent"), (0, "no_extent")):
        table = sound_table()
        for i, axis in enumerate("xyz"):
            table[axis] *= factor
            table[f"scale_{i}"] += np.log(factor) if factor else 0
        assert set(named(check(tmp_path, table))) == {name}


def test_splats_that_are_not_of_the_surface_are_counted(tmp_path):
    table = sound_table(1000)
    for axis in "xyz":
        table[axis][500:] *= 30
    table["opacity"][:4] = -5
    for name in ("scale_0", "scale_1"):
        table[name][:4] = -1
    table["scale_0"][4:7], table["scale_1"][4:7], table["scale_2"][4:7] = -1, -6, -6
    report = check(tmp_path, table)
    found = named(report)
    assert found["floaters"][0] == found["haze"][0] == found["needles"][0] == "warning"
    assert 480 <= found["floaters"][1] <= 520
    assert found["haze"][1] >= 4
    assert found["needles"][1] >= 3
    assert report.ok


def test_a_single_splat_and_none(tmp_path):
    assert check(tmp_path, sound_table(1)).ok
    report = check(tmp_path, sound_table(0))
    assert (report.ok, set(named(report))) == (False, {"no_splats"})


def test_integer_types_are_mistyped(tmp_path):
    table = {name: np.full(3, 7) for name in NAMES}
    assert named(check(tmp_path, table, "uchar"))["mistyped_property"] == ("error", 14)


def test_truncated_and_surplus_bytes(tmp_path):
    check(tmp_path, sound_table())
    path = tmp_path / "a.ply"
    raw = path.read_bytes()
    path.write_bytes(raw + b"more")
    assert named(validate_file(path)) == {"payload_size": ("warning", 1)}
    path.write_bytes(raw[:-5])
    report = validate_file(path)
    assert named(report) == {"truncated_payload": ("error", 1)}
    assert (report.n_splats, report.sh_degree) == (500, 0)


@pytest.mark.parametrize(
    ("content", "name"),
    [
        (b"", "not_a_splat_file"),
        (b"ply\nformat", "bad_header"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
         "not_a_splat_file"),
    ],
)  # fmt: skip
def test_files_that_cannot_be_read(tmp_path, content, name):
    (tmp_path / "a.ply").write_bytes(content)
    report = validate_file(tmp_path / "a.ply")
    assert (report.ok, set(named(report)), report.sh_degree) == (False, {name}, None)
    assert set(named(validate_file(tmp_path / "absent.ply"))) == {"unreadable_file"}


@settings(max_examples=100, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_any_bits_give_a_report(tmp_path, data):
    count = data.draw(st.integers(1, 3)) * 60
    seed = data.draw(st.integers(0, 2**32 - 1))
    bits = np.random.default_rng(seed).integers(0, 256, (count, 14 * 4), dtype=np.uint8)
    bits &= np.uint8(data.draw(st.sampled_from([0xFF, 0x7F, 0x3F, 0x00])))
    values = bits.view("<f4")
    report = check(tmp_path, dict(zip(NAMES, values.T, strict=True)))
    counts = {finding.name: finding.count for finding in report.findings}
    assert counts.get("nan", 0) == np.isnan(values).any(axis=1).sum()
    assert all(counts.get(name, 0) <= count for name in COUNTS)


def test_hash_tells_rows_apart():
    grid = np.stack(np.meshgrid(*[np.arange(-8, 8, dtype="<f4")] * 4), axis=-1).reshape(-1, 4)
    assert len(np.unique(hash_rows(grid))) == len(grid)
    np.testing.assert_array_equal(hash_rows(grid[:5]), hash_rows(grid)[:5])


@pytest.mark.skipif(not DATA.is_dir(), reason="shared/data is absent")
def test_real_files(tmp_path):
    good = validate_file(DATA / "splats/metalsplatter/test-splat.3-points-from-train.ply")
    assert named(good) == {"unnormalised_quaternions": ("info", 3)}
    for name, expected in (
        ("splats/playcanvas/biker.compressed.ply", "compressed_splat_file"),
        ("splats/playcanvas/biker.spz", "not_a_splat_file"),
        ("splats/brush/init.ply", "not_a_splat_file"),
        ("lidar/cupoch_redwood/frag_115.ply", "not_a_splat_file"),
    ):
        assert set(named(validate_file(DATA / name))) == {expected}
    write_splats(
        tmp_path / "b.ply", read_compressed_ply(DATA / "splats/playcanvas/biker.compressed.ply")
    )
    trained = validate_file(tmp_path / "b.ply")
    assert (trained.ok, trained.n_splats) == (True, 152746)
