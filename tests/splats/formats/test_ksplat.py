"""Every level of .ksplat is read: files are written here byte by byte as the format says."""

from pathlib import Path

import numpy as np
import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.splats import Splats
from gscomplete.splats.formats.ksplat import read_ksplat
from tests.splats.formats.test_any_file import some_splats

DATA = Path(__file__).resolve().parents[3] / "../shared/data/splats/splat-transform-fixtures/splat"
BUCKET = 8
BLOCK = 5.0
SH_RANGE = 2.0


def written(path: Path, splats: Splats, level: int) -> Path:
    """One section; rows in buckets of eight, the last one partly filled."""
    count, degree = len(splats), splats.sh_degree
    full, rest = divmod(count, BUCKET)
    buckets = full + (rest > 0) if level else 0
    means = splats.means.numpy()
    real = "<f4" if level == 0 else "<f2"
    harmonics = np.concatenate(
        [
            splats.sh[:, a:b].transpose(1, 2).reshape(count, -1).numpy()
            for a, b in ((1, 4), (4, 9))[:degree]
        ]
        or [np.zeros((count, 0), np.float32)],
        axis=1,
    )
    centers = np.zeros((buckets, 3), np.float32)
    if level:
        owner = np.arange(count) // BUCKET
        centers = np.stack([means[owner == k].mean(axis=0) for k in range(buckets)])
        steps = (means - centers[owner]) / (BLOCK / 2 / 32767) + 32767
        stored = np.rint(steps).astype("<u2")
    else:
        stored = means.astype("<f4")
    if level == 2:
        harmonics = np.rint((harmonics + SH_RANGE) / (2 * SH_RANGE) * 255).clip(0, 255)
    rgba = torch.cat([splats.base_colors, splats.opacities[:, None]], dim=1).clamp(0, 1) * 255
    parts = [
        stored,
        splats.scales.numpy().astype(real),
        splats.quaternions.numpy().astype(real),
        rgba.round().numpy().astype("u1"),
        harmonics.astype(("<f4", "<f2", "u1")[level]),
    ]
    rows = b"".join(b"".join(part[i].tobytes() for part in parts) for i in range(count))
    head = np.zeros(4096, np.uint8)
    head[1] = 1
    head.view("<u4")[1:5] = 1, 1, count, count
    head.view("<u2")[10] = level
    head.view("<f4")[9:11] = -SH_RANGE, SH_RANGE
    section = np.zeros(1024, np.uint8)
    section.view("<u4")[:4] = count, count, BUCKET, buckets
    section.view("<f4")[4] = BLOCK
    section.view("<u2")[10] = 12 if level else 0
    section.view("<u4")[8:10] = full if level else 0, int(rest > 0) if level else 0
    section.view("<u2")[20] = degree
    partly = np.array([rest] if level and rest else [], "<u4")
    data = (head.tobytes(), section.tobytes(), partly.tobytes(), centers.astype("<f4").tobytes())
    path.write_bytes(b"".join((*data, rows)))
    return path


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("bands", [1, 4, 9])
def test_every_level_and_degree_is_read(tmp_path: Path, level: int, bands: int) -> None:
    splats = some_splats(21, bands)
    found = read_ksplat(written(tmp_path / "a.ksplat", splats, level))
    exact = 1e-6 if level == 0 else 1e-3  # float16 has 11 bits; positions steps of 5 / 65534
    torch.testing.assert_close(found.means, splats.means, atol=max(exact / 10, 1e-6), rtol=0)
    torch.testing.assert_close(found.scales, splats.scales, atol=0, rtol=exact)
    torch.testing.assert_close(found.quaternions, splats.quaternions, atol=exact, rtol=0)
    torch.testing.assert_close(found.opacities, splats.opacities, atol=0.5 / 255 + 1e-6, rtol=0)
    shown = splats.base_colors.clamp(0, 1)
    torch.testing.assert_close(found.base_colors, shown, atol=0.5 / 255 + 1e-6, rtol=0)
    step = SH_RANGE / 255 + 1e-6 if level == 2 else exact
    torch.testing.assert_close(found.sh[:, 1:], splats.sh[:, 1:], atol=step, rtol=0)


def test_a_quaternion_of_zeros_is_no_rotation(tmp_path: Path) -> None:
    splats = some_splats(3)
    splats.quaternions[1] = 0.0
    found = read_ksplat(written(tmp_path / "a.ksplat", splats, 0))
    assert found.quaternions[1].tolist() == [1.0, 0.0, 0.0, 0.0]


def test_a_file_of_another_writer_is_read() -> None:
    if not (DATA / "minimal.ksplat").is_file():
        pytest.skip("real data are not here (../shared/data)")
    found = read_ksplat(DATA / "minimal.ksplat")
    assert len(found) > 0
    assert found.means.isfinite().all()
    assert (found.quaternions.norm(dim=1) - 1).abs().max() < 1e-5


def test_odd_files_are_refused_in_one_line(tmp_path: Path) -> None:
    path = written(tmp_path / "a.ksplat", some_splats(21), 1)
    whole = path.read_bytes()

    def changed(at: int, value: int) -> bytes:
        return whole[:at] + value.to_bytes(4, "little") + whole[at + 4 :]

    cases = [
        (whole[:100], "header of 4096 bytes, found 100"),
        (changed(0, 1), "expected .ksplat version 0.1, found 1.0"),
        (changed(20, 7), "compression level: expected 0, 1 or 2, found 7"),
        (changed(4, 2**31), "expected headers of 2,147,483,648 sections"),
        (whole[:-10], "section 0: expected"),
        (changed(16, 22), "expected 22 splats, found 21"),
        (changed(4096 + 40, 9), "found degree 9"),
        (changed(4096 + 32, 0), "expected buckets for 21 splats"),
    ]
    for data, message in cases:
        path.write_bytes(data)
        with pytest.raises(UserError, match=message):
            read_ksplat(path)
