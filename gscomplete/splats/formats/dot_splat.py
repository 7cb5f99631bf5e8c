"""antimatter15's .splat: 32 bytes a splat, without a header.

Conventions
-----------
* Position and linear scales are float32, sRGB colour and opacity bytes, the quaternion (w, x, y, z)
  bytes (value x 128 + 128). There are no harmonics. The frame is that of a PLY.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.splats.record import Splats, colors_to_sh
from gscomplete.splats.rotations import unit_quaternions
from gscomplete.util.atomic import atomic_path

_HALF_STEP = 0.5 / 255
_ROW = np.dtype([("xyz", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rot", "u1", 4)])


def read_dot_splat(path: Path) -> Splats:
    """Read a .splat file.

    Raises:
        UserError: its size is no number of splats, or a scale is negative.
    """
    size = path.stat().st_size
    if size == 0 or size % _ROW.itemsize:
        raise UserError(f"{path}: expected a multiple of 32 bytes, found {size}")
    rows = np.fromfile(path, _ROW)
    negative = int((rows["scale"] < 0).any(axis=1).sum())
    if negative:
        raise UserError(f"{path}: scale: expected no negative one, found {negative:,} splats with")
    quaternions = unit_quaternions((rows["rot"].astype(np.float32) - 128.0) / 128.0)
    colors = rows["rgba"].astype(np.float32) / 255.0
    return Splats(
        torch.from_numpy(rows["xyz"].copy()),
        torch.from_numpy(np.ascontiguousarray(quaternions)),
        torch.from_numpy(rows["scale"].copy()),
        torch.from_numpy(colors[:, 3].copy()),
        colors_to_sh(torch.from_numpy(colors[:, :3].copy())),
    )


def write_dot_splat(path: Path, splats: Splats) -> tuple[str, ...]:
    """Write a .splat file; return what is lost.

    Raises:
        UserError: the file cannot be written.
    """
    rows = np.zeros(len(splats), _ROW)
    rows["xyz"] = splats.means.numpy()
    rows["scale"] = splats.scales.numpy()
    rgba = torch.cat([splats.base_colors, splats.opacities[:, None]], dim=1).clamp(0, 1) * 255
    rows["rgba"] = rgba.round().to(torch.uint8).numpy()
    turned = (splats.quaternions * 128 + 128).round().clamp(0, 255)
    rows["rot"] = turned.to(torch.uint8).numpy()
    with atomic_path(path) as temporary:
        temporary.write_bytes(rows.tobytes())
    lost = ["8-bit colours and rotations"]
    beyond = (splats.base_colors - splats.base_colors.clamp(0, 1)).abs() > _HALF_STEP
    count = int(beyond.any(dim=1).sum())
    if count:
        lost.append(f"colours outside [0, 1] of {count:,} splats")
    if splats.sh_degree:
        lost.append(f"harmonics of degree {splats.sh_degree}")
    return tuple(lost)
