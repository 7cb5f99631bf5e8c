"""Splat files of other formats come and go with what they can hold."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.splats import Splats, append_splats, read_splats
from gscomplete.splats.formats.any_file import (
    format_of,
    read_any_splats,
    read_splat_file,
    write_any_splats,
)
from splatcomplete_data.cli import main
from tests.builders.full_disk import files_end_at
from tests.builders.ply_files import FORMATS, make_ply, random_table

DATA = Path(__file__).resolve().parents[3] / "../shared/data/splats"


def some_splats(count: int = 300, bands: int = 4) -> Splats:
    generator = torch.Generator().manual_seed(2)
    quaternions = torch.randn(count, 4, generator=generator)
    return Splats(
        torch.randn(count, 3, generator=generator),
        torch.nn.functional.normalize(quaternions, dim=1),
        (torch.randn(count, 3, generator=generator) * 0.3 - 3).exp(),
        torch.rand(count, generator=generator),
        torch.randn(count, bands, 3, generator=generator) * 0.2,
    )


def covariances(splats: Splats) -> torch.Tensor:
    from gscomplete.splats.rotations import rotation_matrices

    axes = rotation_matrices(splats.quaternions) * splats.scales[:, None, :]
    return axes @ axes.transpose(1, 2)


# Half a step of a coordinate: SPZ's, with 15 fractional bits for an extent of 4; 10 bits for a
# range of 7; 16 bits for a logarithm of +-1.6, which grows by up to 4.7 when it is undone. The
# others keep float32.
HALF_STEPS = {
    "ply": 0.0,
    "splat": 0.0,
    "spz": 0.51 / 2**15,
    "compressed.ply": 0.51 * 7 / 1023,
    "glb": 0.0,
    "sog": 0.51 * 3.2 / 65535 * 4.7,
}


@pytest.mark.parametrize("kind", HALF_STEPS)
def test_round_trip(tmp_path: Path, kind: str) -> None:
    if kind in ("spz", "compressed.ply"):
        pytest.importorskip("gsply")
    splats = some_splats()
    path = tmp_path / f"a.{kind}"
    write_any_splats(path, splats)
    back = read_any_splats(path).splats
    assert len(back) == len(splats)
    a, b = splats, back.select(torch.cdist(splats.means, back.means).argmin(dim=1))
    torch.testing.assert_close(a.means, b.means, atol=HALF_STEPS[kind], rtol=0)
    torch.testing.assert_close(a.opacities, b.opacities, atol=0.51 / 255, rtol=0)
    # SPZ's steps are the coarsest: a byte for 6.7 of the coefficient. Measured: 0.0037.
    torch.testing.assert_close(a.base_colors, b.base_colors, atol=0.004, rtol=0)
    size = a.scales.amax(dim=1).square()[:, None, None]
    assert ((covariances(a) - covariances(b)).abs() / size).median() < 0.05
    if kind == "spz":
        # Half a step of 1/128 here; writers may keep 4 of the 8 bits, in steps of 1/8.
        torch.testing.assert_close(a.sh[:, 1:], b.sh[:, 1:], atol=0.08, rtol=0)


def convert(tmp_path: Path, raw: bytes, capsys: pytest.CaptureFixture[str]) -> str:
    (tmp_path / "in.ply").write_bytes(raw)
    assert main(["convert", str(tmp_path / "in.ply"), str(tmp_path / "out.ply")]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("form", FORMATS)
def test_what_a_converted_ply_lacks_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], form: str
) -> None:
    table = random_table(3, 0)
    table |= {"nx": np.zeros(3), "ny": np.zeros(3), "nz": np.array([0, 1, 0]), "label": np.ones(3)}
    extra = ("element camera 0\nproperty float f\n", b"")
    comments = tuple(f"text {number}" for number in range(7))
    raw = make_ply(table, form, types={"label": "uchar"}, comments=comments, after=extra)
    said = convert(tmp_path, raw, capsys)
    assert "lost: properties label, nx, ny, nz, elements camera, comments 'text 0'," in said
    assert "'text 4' and 2 more" in said
    assert read_splats(tmp_path / "out.ply").comments == ()


@pytest.mark.parametrize("form", FORMATS)
def test_normals_of_zeros_are_no_loss(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], form: str
) -> None:
    table = random_table(3, 0) | {name: np.zeros(3) for name in ("nx", "ny", "nz")}
    assert "lost" not in convert(tmp_path, make_ply(table, form), capsys)


def test_a_negative_scale_is_named(tmp_path: Path) -> None:
    row = np.zeros(1, [("xyz", "<f4", 3), ("scale", "<f4", 3), ("bytes", "u1", 8)])
    row["scale"], row["bytes"] = (0.1, -0.1, 0.1), 200
    row.tofile(tmp_path / "a.splat")
    with pytest.raises(UserError, match=r"a\.splat: scale: expected no negative one, found 1"):
        read_any_splats(tmp_path / "a.splat")


def test_odd_files_are_user_errors(tmp_path: Path) -> None:
    for name, content in (("a.splat", bytes(33)), ("b.spz", b"\x1f\x8b bad"), ("c.splat", b"")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(UserError, match=name):
            read_any_splats(tmp_path / name)
    for name in ("a.ksplat", "none.ply", "ply", "a.usda"):
        with pytest.raises(UserError, match=name):
            read_any_splats(tmp_path / name)
    bad = some_splats(3)
    bad.means[0, 0] = float("nan")
    with pytest.raises(UserError, match="finite"):
        write_any_splats(tmp_path / "x.splat", bad)
    assert not (tmp_path / "x.splat").exists()
    with pytest.raises(UserError, match="expected a format that is written"):
        write_any_splats(tmp_path / "x.ksplat", some_splats(3))
    assert format_of(Path("A.Compressed.PLY")) == "compressed.ply"


@pytest.mark.parametrize("kind", ["splat", "glb", "sog", "compressed.ply"])
def test_files_of_any_format_can_be_appended_to(tmp_path: Path, kind: str) -> None:
    """As a PLY: a completion's records follow those of the converted part."""
    if kind == "compressed.ply":
        pytest.importorskip("gsply")
    path = tmp_path / f"a.{kind}"
    write_any_splats(path, some_splats(20))
    file = read_splat_file(path)
    assert file.path == path
    assert f"converted from .{kind} to PLY" in file.warnings
    append_splats(tmp_path / "b.ply", file, some_splats(2, 1))
    both = read_splats(tmp_path / "b.ply")
    assert both.n_rows == 22
    assert bytes(both.payload.records).startswith(bytes(file.payload.records))


@pytest.mark.parametrize("kind", [*HALF_STEPS, "usda", "usdc"])
def test_a_full_disk_is_told_and_leaves_nothing(tmp_path: Path, kind: str) -> None:
    if kind in ("spz", "compressed.ply"):
        pytest.importorskip("gsply")
    if kind in ("usda", "usdc"):
        pytest.importorskip("pxr")
    told = rf"{tmp_path}/a.{kind}: cannot write: .*(?i:large)"
    with files_end_at(10_000), pytest.raises(UserError, match=told):
        write_any_splats(tmp_path / f"a.{kind}", some_splats(5000))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("floaters", "told"), [(0, False), (2, True)])
def test_positions_that_floaters_make_coarse_are_told(
    tmp_path: Path, floaters: int, told: bool
) -> None:
    pytest.importorskip("gsply")
    splats = some_splats(1000)
    splats.means[:floaters] *= 1e4
    path = tmp_path / "a.compressed.ply"
    lost = write_any_splats(path, splats)
    assert any("floaters" in note for note in lost) == told
    back = read_any_splats(path).splats
    near = torch.cdist(splats.means[floaters:], back.means).amin(dim=1)
    assert (near > 0.1).any().item() == told


@pytest.mark.parametrize(
    ("kind", "change", "words"),
    [
        ("splat", {"sh": 9.0}, "colours outside"),
        ("spz", {"sh": 9.0}, "colours of 5 splats"),
        ("spz", {"sh": 9.0}, "harmonics beyond 1 of 5"),
        ("compressed.ply", {"scales": 1e-12}, "scales below 2.1e-09 of 5"),
    ],
)
def test_values_beyond_a_format_are_told(
    tmp_path: Path, kind: str, change: dict[str, float], words: str
) -> None:
    if kind != "splat":
        pytest.importorskip("gsply")
    splats = some_splats(100)
    splats = dataclasses.replace(splats, sh=splats.sh.clamp(-0.9, 0.9))
    sound = write_any_splats(tmp_path / f"a.{kind}", splats)
    assert not any(words in note for note in sound)
    for name, value in change.items():
        getattr(splats, name)[:5] = value
    assert any(words in note for note in write_any_splats(tmp_path / f"b.{kind}", splats))


@pytest.mark.parametrize("kind", ["spz", "splat"])
def test_real_files_agree_with_their_ply(kind: str) -> None:
    stem = DATA / "metalsplatter/test-splat.3-points-from-train"
    if not stem.with_name(stem.name + ".ply").is_file():
        pytest.skip("real data are not here (../shared/data)")
    pytest.importorskip("gsply")
    real = read_any_splats(Path(f"{stem}.ply")).splats
    other = read_any_splats(Path(f"{stem}.{kind}")).splats
    torch.testing.assert_close(real.means, other.means, atol=2e-4, rtol=0)
    relative = (covariances(real) - covariances(other)).abs()
    assert (relative / covariances(real).abs().amax(dim=(1, 2), keepdim=True)).max() < 0.1


@pytest.mark.parametrize("suffix", ["splat", "glb", "sog", "spz", "compressed.ply", "usda"])
def test_no_splats_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    (tmp_path / "none.ply").write_bytes(make_ply(random_table(0, 0), "binary_little_endian"))
    path = tmp_path / f"a.{suffix}"
    assert main(["convert", str(tmp_path / "none.ply"), str(path)]) == 2
    error = capsys.readouterr().err
    assert f"{path}: expected splats that can be drawn, found none" in error
    assert not path.exists()
