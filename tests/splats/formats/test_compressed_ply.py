"""SuperSplat's compressed PLY: unpacking against a slow packer, and a real trained file."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from gscomplete.splats import PlyError, write_splats
from gscomplete.splats.formats.compressed_ply import read_compressed_ply
from gscomplete.splats.record import SH_C0, Splats

DATA = (Path(__file__).resolve().parents[2] / "../shared/data").resolve()
BIKER = DATA / "splats/playcanvas/biker.compressed.ply"
RANGES = [f"{e}_{a}" for e in ("min", "max") for a in "xyz"]
RANGES += [f"{e}_scale_{a}" for e in ("min", "max") for a in "xyz"]
COLORS = [f"{e}_{c}" for e in ("min", "max") for c in "rgb"]


def unorm(value: float, bits: int) -> int:
    top = (1 << bits) - 1
    return min(top, max(0, math.floor(value * top + 0.5)))


def pack_triple(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> int:
    x, y, z = (values - low) / np.maximum(high - low, 1e-9)
    return unorm(x, 11) << 21 | unorm(y, 10) << 11 | unorm(z, 11)


def pack_rotation(quaternion: np.ndarray) -> int:
    largest = int(np.abs(quaternion).argmax())
    quaternion = quaternion * np.sign(quaternion[largest])
    word = largest
    for i in range(4):
        if i != largest:
            word = word << 10 | unorm(quaternion[i] / math.sqrt(2) + 0.5, 10)
    return word


def pack(splats: Splats, with_colors: bool) -> bytes:
    """The slow obvious packer: one splat at a time."""
    means, logs = splats.means.numpy(), splats.scales.log().numpy()
    colors, count = splats.base_colors.numpy(), len(splats)
    chunks, words = [], []
    for start in range(0, count, 256):
        rows = slice(start, start + 256)
        ends = [f(v[rows], axis=0) for v in (means, logs) for f in (np.min, np.max)]
        low, high = colors[rows].min(axis=0), colors[rows].max(axis=0)
        if not with_colors:
            low, high = np.zeros(3), np.ones(3)
        chunks += [*ends, low, high] if with_colors else ends
        for i in range(start, min(start + 256, count)):
            rgb = [unorm(c, 8) for c in (colors[i] - low) / (high - low)]
            alpha = unorm(splats.opacities[i].item(), 8)
            words += [
                pack_triple(means[i], ends[0], ends[1]),
                pack_rotation(splats.quaternions[i].numpy()),
                pack_triple(logs[i], ends[2], ends[3]),
                rgb[0] << 24 | rgb[1] << 16 | rgb[2] << 8 | alpha,
            ]
    names = RANGES + (COLORS if with_colors else [])
    lines = ["ply", "format binary_little_endian 1.0", f"element chunk {-(-count // 256)}"]
    lines += [f"property float {name}" for name in names]
    lines += [f"element vertex {count}"]
    lines += [f"property uint packed_{n}" for n in ("position", "rotation", "scale", "color")]
    rest = 3 * (splats.sh.shape[1] - 1)
    body = np.concatenate(chunks).astype("<f4").tobytes() + np.array(words, "<u4").tobytes()
    if rest:
        lines += [f"element sh {count}", *(f"property uchar f_rest_{i}" for i in range(rest))]
        flat = splats.sh[:, 1:].transpose(1, 2).reshape(count, rest).numpy()
        body += np.clip((flat / 8 + 0.5) * 256, 0, 255).astype("u1").tobytes()
    return "\n".join([*lines, "end_header", ""]).encode() + body


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("with_colors", [True, False])
def test_unpacks_what_was_packed(tmp_path, degree, with_colors):
    generator = torch.Generator().manual_seed(degree)
    count = 300
    quaternions = torch.randn(count, 4, generator=generator)
    sh = torch.randn(count, (degree + 1) ** 2, 3, generator=generator).clamp(-3.9, 3.9)
    sh[:, 0] = (torch.rand(count, 3, generator=generator) - 0.5) / SH_C0
    splats = Splats(
        torch.randn(count, 3, generator=generator),
        torch.nn.functional.normalize(quaternions, dim=1),
        torch.randn(count, 3, generator=generator).exp(),
        torch.rand(count, generator=generator),
        sh,
    )
    (tmp_path / "a.compressed.ply").write_bytes(pack(splats, with_colors))
    found = read_compressed_ply(tmp_path / "a.compressed.ply")
    assert (found.means - splats.means).abs().max() < 8 / 1023 / 2
    assert (found.scales.log() - splats.scales.log()).abs().max() < 8 / 1023 / 2
    assert (found.opacities - splats.opacities).abs().max() < 0.51 / 255
    assert (found.base_colors - splats.base_colors).abs().max() < 0.51 / 255
    # half a step of a byte for a range of 8
    assert torch.allclose(found.sh[:, 1:], splats.sh[:, 1:], rtol=0, atol=0.51 * 8 / 256)
    same = (found.quaternions * splats.quaternions).sum(dim=1).abs()
    assert same.min() > 0.99999


def test_other_files_are_refused(tmp_path):
    one = Splats(torch.zeros(1, 3), torch.eye(4)[:1], torch.ones(1, 3), torch.ones(1),
                 torch.zeros(1, 4, 3))  # fmt: skip
    write_splats(tmp_path / "a.ply", one)
    with pytest.raises(PlyError, match="chunk"):
        read_compressed_ply(tmp_path / "a.ply")
    raw = pack(one, False)
    cases = [
        raw[:-13],
        raw.replace(b"chunk 1", b"chunk 2"),
        raw.replace(b"uint packed_s", b"int q"),
    ]
    for case in [*cases, raw[:-1], raw.replace(b"f_rest_8", b"f_rest_9")]:
        (tmp_path / "b.ply").write_bytes(case)
        with pytest.raises(PlyError):
            read_compressed_ply(tmp_path / "b.ply")


@pytest.mark.skipif(not BIKER.exists(), reason="shared/data is absent")
def test_trained_file_is_plausible():
    splats = read_compressed_ply(BIKER)
    assert len(splats) == 152746
    assert all(bool(value.isfinite().all()) for _, value in splats.fields())
    assert 0.1 < splats.opacities.median() < 0.9
    assert 0 < splats.base_colors.median() < 1
    extent = (splats.means.quantile(0.95, dim=0) - splats.means.quantile(0.05, dim=0)).max()
    assert 1e-4 * extent < splats.scales.median() < 0.1 * extent
