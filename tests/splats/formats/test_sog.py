"""SOG keeps what its bytes can hold, where the format's specification says."""

import io
import json
import math
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from gscomplete.errors import UserError
from gscomplete.splats import Splats
from gscomplete.splats.formats import sog
from gscomplete.splats.formats.any_file import read_any_splats
from gscomplete.splats.formats.palette import codebook, row_palette
from gscomplete.splats.formats.sog import read_sog, write_sog
from gscomplete.splats.rotations import rotation_matrices
from tests.splats.formats.test_any_file import some_splats


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Splats]:
    path = tmp_path_factory.mktemp("sog") / "a.sog"
    splats = some_splats(1000, 16)
    assert write_sog(path, splats) == ("values are quantised", "the order of splats")
    return path, splats


def matched(found: Splats, splats: Splats) -> Splats:
    """The read splats in the order of those that were written."""
    return found.select(torch.cdist(splats.means, found.means).argmin(dim=1))


def test_values_are_as_near_as_their_bytes_allow(written: tuple[Path, Splats]) -> None:
    path, splats = written
    found = matched(read_sog(path), splats)
    # 16 bits of ln(1 + |x|), whose slope is 1 / (1 + |x|): half a step at the largest |x|
    logs = splats.means.sign() * splats.means.abs().log1p()
    half_step = (logs.amax(0) - logs.amin(0)) / 65535 / 2
    bound = half_step * (1 + splats.means.abs()) * 1.01 + 1e-6
    assert ((found.means - splats.means).abs() <= bound).all()
    assert (found.opacities - splats.opacities).abs().max() <= 0.5 / 255 + 1e-6
    assert (found.scales.log() - splats.scales.log()).abs().mean() < 0.005
    assert (found.sh - splats.sh).abs().mean() < 0.005
    turn = rotation_matrices(found.quaternions) @ rotation_matrices(splats.quaternions).mT
    angle = ((turn.diagonal(dim1=1, dim2=2).sum(1) - 1) / 2).clamp(-1, 1).arccos()
    # three components, each within sqrt(1/2) / 255; the fourth follows from them, at worst (where
    # all four are 1/2) doubling the error; an angle is twice the quaternions' distance
    assert angle.max() < 4 * 3**0.5 * 0.5**0.5 / 255


def test_the_same_splats_give_the_same_bytes(written: tuple[Path, Splats], tmp_path: Path) -> None:
    path, splats = written
    write_sog(tmp_path / "b.sog", splats)
    assert (tmp_path / "b.sog").read_bytes() == path.read_bytes()


def test_values_are_where_the_format_says(written: tuple[Path, Splats]) -> None:
    """Pixel by pixel, with the formulas of PlayCanvas's specification written out."""
    path, _ = written
    found = read_sog(path)
    with zipfile.ZipFile(path) as archive:
        meta = json.loads(archive.read("meta.json"))
        pixels = {
            name: np.asarray(Image.open(archive.open(name)).convert("RGBA"))
            for name in archive.namelist()
            if name.endswith(".webp")
        }
    codes = {name: meta[name]["codebook"] for name in ("scales", "sh0", "shN")}
    for index in (0, 1, 517, 999):
        y, x = divmod(index, pixels["quats.webp"].shape[1])
        for axis in range(3):
            low, high = meta["means"]["mins"][axis], meta["means"]["maxs"][axis]
            step = int(pixels["means_u.webp"][y, x, axis]) << 8
            value = low + (high - low) * (step | int(pixels["means_l.webp"][y, x, axis])) / 65535
            mean = math.copysign(math.exp(abs(value)) - 1, value)
            assert found.means[index, axis] == pytest.approx(mean, abs=1e-5)
            scale = math.exp(codes["scales"][pixels["scales.webp"][y, x, axis]])
            assert found.scales[index, axis] == pytest.approx(scale, rel=1e-5)
            base = codes["sh0"][pixels["sh0.webp"][y, x, axis]]
            assert found.sh[index, 0, axis] == pytest.approx(base, abs=1e-5)
        assert found.opacities[index] == pytest.approx(pixels["sh0.webp"][y, x, 3] / 255)
        a, b, c, tag = (int(value) for value in pixels["quats.webp"][y, x])
        rest = [(value / 255 - 0.5) * 2 / math.sqrt(2) for value in (a, b, c)]
        rest.insert(tag - 252, math.sqrt(1 - sum(value * value for value in rest)))
        assert found.quaternions[index].tolist() == pytest.approx(rest, abs=1e-5)
        label = int(pixels["shN_labels.webp"][y, x, 0]) + 256 * int(
            pixels["shN_labels.webp"][y, x, 1]
        )
        row, column = label // 64, label % 64 * 15
        for k in range(15):
            bytes_ = pixels["shN_centroids.webp"][row, column + k, :3]
            expected = [codes["shN"][value] for value in bytes_]
            assert found.sh[index, 1 + k].tolist() == pytest.approx(expected, abs=1e-5)


def test_a_folder_is_read_like_the_file(written: tuple[Path, Splats], tmp_path: Path) -> None:
    path, _ = written
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path / "scene")
    for source in (tmp_path / "scene", tmp_path / "scene" / "meta.json"):
        assert (read_any_splats(source).splats.means == read_sog(path).means).all()


def rewritten(path: Path, target: Path, changes: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            new.writestr(name, changes.get(name, old.read(name)))
    return target


def test_odd_files_are_refused_in_one_line(
    written: tuple[Path, Splats], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, _ = written
    with zipfile.ZipFile(path) as archive:
        meta = json.loads(archive.read("meta.json"))
    small = io.BytesIO()
    Image.new("RGBA", (4, 4)).save(small, "WEBP", lossless=True)
    outside = meta | {"quats": {"files": ["../quats.webp"]}}
    many = meta | {"count": 10**9}
    cases: list[tuple[dict[str, bytes], str]] = [
        ({"meta.json": b"{}"}, "expected SOG version 2, found None"),
        ({"meta.json": b"[1"}, "cannot read it as SOG"),
        ({"meta.json": json.dumps(outside).encode()}, "expected names of files beside it"),
        ({"meta.json": json.dumps(many).encode()}, "count: expected a number of splats"),
        ({"quats.webp": small.getvalue()}, "quats.webp: expected 1,000 pixels, found 4 x 4"),
        ({"scales.webp": b"RIFF"}, "cannot read it as SOG"),
    ]
    for number, (changes, message) in enumerate(cases):
        odd = rewritten(path, tmp_path / f"{number}.sog", changes)
        with pytest.raises(UserError, match=message):
            read_sog(odd)
    monkeypatch.setattr(sog, "most_decoded_bytes", lambda path: 1000)
    with pytest.raises(UserError, match=r"means_l\.webp: 32 x 32 pixels are too many"):
        read_sog(path)
    (tmp_path / "cut.sog").write_bytes(path.read_bytes()[:-40])
    with pytest.raises(UserError, match="cannot read it as SOG"):
        read_sog(tmp_path / "cut.sog")


def test_codebooks_are_as_good_as_plain_k_means() -> None:
    """Against Lloyd's algorithm written out, from the same start."""
    values = np.random.default_rng(0).normal(size=5000).astype(np.float32)
    codes, labels = codebook(values)
    assert (np.diff(codes) >= 0).all()
    shares = (np.arange(128) + 0.5) / 128
    even = values.min() + shares * np.ptp(values)
    centers = np.sort(np.concatenate([np.quantile(values, shares), even]))
    for _ in range(24):
        nearest = np.abs(values[:, None] - centers).argmin(axis=1)
        for k in np.unique(nearest):
            centers[k] = values[nearest == k].mean()
    plain = np.square(values - centers[np.abs(values[:, None] - centers).argmin(axis=1)]).mean()
    assert np.square(values - codes[labels]).mean() <= plain * 1.01
    assert np.abs(values - codes[labels]).max() < np.ptp(values) / 128


def test_few_rows_stand_for_themselves_and_many_for_their_neighbours() -> None:
    generator = torch.Generator().manual_seed(0)
    corners = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [9.0, 9.0]])
    own, labels = row_palette(corners, 4)
    assert (own[labels] == corners).all()
    rows = corners[torch.randint(4, (400,), generator=generator)]
    rows = rows + 0.01 * torch.randn(400, 2, generator=generator)
    palette, labels = row_palette(rows, 40)
    assert (palette[labels] - rows).norm(dim=1).max() < 0.05
