"""Read .ksplat, the format of mkkellogg's GaussianSplats3D, versions 0.1 and up.

Conventions
-----------
* A header of 4,096 bytes, then one of 1,024 bytes for every section, then the sections: sizes of
  the buckets that are not full (uint32), centres of the buckets (float32 x 3), rows of splats.
* Level 0 stores float32. Levels 1 and 2 store positions as uint16 about the centre of their
  bucket, scales and quaternions (w, x, y, z) as float16; harmonics are float16 or, at level 2,
  bytes over a range that the header gives. Colours and opacities are bytes at every level.
* Harmonics lie band by band, channel by channel within a band. The frame is that of a PLY.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from gscomplete.errors import UserError
from gscomplete.splats.record import Splats, colors_to_sh, concatenate
from gscomplete.splats.rotations import unit_quaternions
from gscomplete.util.arrays import Float64Array, IntArray

_HEADER, _SECTION = 4096, 1024
_HARMONICS = {0: 0, 1: 9, 2: 24}
_BANDS = ((1, 4), (4, 9))
"""First coefficient of a band, and the first of the next."""
_SH_RANGE = 1.5
"""Range of harmonics where the header gives none."""
_BUCKET_RANGE = 32767
"""Steps from a bucket's centre to its side where the section gives none."""


@dataclass(frozen=True, slots=True)
class _Header:
    """What holds for every section."""

    level: int
    count: int
    sections: int
    sh_low: float
    sh_high: float


def read_ksplat(path: Path) -> Splats:
    """Read a .ksplat file.

    Raises:
        UserError: it is no such file, of another version, or shorter than it says.
    """
    data = path.read_bytes()
    head = _header(path, data)
    parts, offset = [], _HEADER + _SECTION * head.sections
    for index in range(head.sections):
        part, offset = _section(path, data, head, index, offset)
        parts += [part] if part is not None else []
    found = sum(len(part) for part in parts)
    if not parts or found != head.count:
        raise UserError(f"{path}: expected {head.count:,} splats, found {found:,}")
    return concatenate(parts)


def _header(path: Path, data: bytes) -> _Header:
    """Read and check the file's header."""
    if len(data) < _HEADER:
        raise UserError(f"{path}: expected a .ksplat header of {_HEADER} bytes, found {len(data)}")
    if data[0] != 0 or data[1] < 1:
        raise UserError(f"{path}: expected .ksplat version 0.1, found {data[0]}.{data[1]}")
    sections, count = (int.from_bytes(data[at : at + 4], "little") for at in (4, 16))
    level = int.from_bytes(data[20:22], "little")
    if level not in (0, 1, 2):
        raise UserError(f"{path}: compression level: expected 0, 1 or 2, found {level}")
    if _HEADER + _SECTION * sections > len(data):
        raise UserError(f"{path}: expected headers of {sections:,} sections, found the file's end")
    low, high = np.frombuffer(data, "<f4", 2, 36).tolist()
    return _Header(level, count, sections, low or -_SH_RANGE, high or _SH_RANGE)


def _section(
    path: Path, data: bytes, head: _Header, index: int, start: int
) -> tuple[Splats | None, int]:
    """Read one section; return its splats, and where the next one starts."""
    words = np.frombuffer(data, "<u4", _SECTION // 4, _HEADER + _SECTION * index)
    count, room, bucket, buckets = (int(word) for word in words[:4])
    full, partly = int(words[8]), int(words[9])
    storage, degree = int(words[5]) & 0xFFFF, int(words[10]) & 0xFFFF
    if degree not in _HARMONICS or count > room:
        raise UserError(
            f"{path}: section {index}: expected harmonics of degree 0 to 2 and at most {room:,} "
            f"splats, found degree {degree} and {count:,}"
        )
    row = _row(head.level, _HARMONICS[degree])
    at_buckets = start + 4 * partly
    at_rows = at_buckets + storage * buckets
    end = at_rows + row.itemsize * room
    if end > len(data) or (head.level and (storage != 12 or full + partly > buckets)):
        raise UserError(f"{path}: section {index}: expected {end:,} bytes, found {len(data):,}")
    if count == 0:
        return None, end
    rows = np.frombuffer(data, row, count, at_rows)
    negative = int((rows["scale"] < 0).any(axis=1).sum())
    if negative:
        raise UserError(f"{path}: scale: expected no negative one, found {negative:,} splats with")
    means = rows["mean"].astype(np.float64)
    if head.level:
        stored = np.frombuffer(data, "<f4", 3 * buckets, at_buckets)
        centers = stored.astype(np.float64).reshape(-1, 3)
        sizes = np.frombuffer(data, "<u4", partly, start).astype(np.int64)
        owner = _owners(path, index, count, bucket, full, sizes)
        span = float(np.frombuffer(words[4:5].tobytes(), "<f4")[0]) / 2
        steps = int(words[6]) or _BUCKET_RANGE
        means = (means - steps) * (span / steps) + centers[owner]
    return _splats(means, rows, head, degree), end


def _row(level: int, harmonics: int) -> np.dtype:
    """Return the layout of a splat."""
    real = "<f4" if level == 0 else "<f2"
    mean = "<f4" if level == 0 else "<u2"
    coefficient = ("<f4", "<f2", "u1")[level]
    return np.dtype(
        [
            ("mean", mean, 3),
            ("scale", real, 3),
            ("rot", real, 4),
            ("rgba", "u1", 4),
            ("sh", coefficient, harmonics),
        ]
    )


def _owners(
    path: Path, index: int, count: int, bucket: int, full: int, sizes: IntArray
) -> IntArray:  # [count]
    """Return the bucket of every row: full buckets come first."""
    starts = np.concatenate([bucket * np.arange(1, full + 1), bucket * full + np.cumsum(sizes)])
    if len(starts) == 0 or starts[-1] < count:
        raise UserError(f"{path}: section {index}: expected buckets for {count:,} splats")
    return np.searchsorted(starts, np.arange(count), side="right")


def _splats(
    means: Float64Array,  # [N, 3]
    rows: NDArray,  # [N]
    head: _Header,
    degree: int,
) -> Splats:
    """Turn rows into splats."""
    quaternions = np.ascontiguousarray(unit_quaternions(rows["rot"].astype(np.float32)))
    rgba = torch.from_numpy(rows["rgba"].astype(np.float32) / 255)
    sh = [colors_to_sh(rgba[:, :3])]
    stored: NDArray[Any] = rows["sh"].astype(np.float32)
    if head.level == 2:
        stored = head.sh_low + stored / 255 * (head.sh_high - head.sh_low)
    for first, last in _BANDS[:degree]:
        band = stored[:, 3 * (first - 1) : 3 * (last - 1)].reshape(len(rows), 3, last - first)
        sh.append(torch.from_numpy(np.ascontiguousarray(band.transpose(0, 2, 1))))
    return Splats(
        torch.from_numpy(means.astype(np.float32)),
        torch.from_numpy(quaternions),
        torch.from_numpy(rows["scale"].astype(np.float32)),
        rgba[:, 3].clone(),
        torch.cat(sh, dim=1),
    )
