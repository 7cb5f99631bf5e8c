"""A small network that guesses how far the complete object reaches beyond P's box.

Conventions
-----------
* P is in z-up axes. Its volume covers P's box, centred and scaled to largest side 1, with a margin:
  the share of filled cells and the mean outward normal of each, [4, C, C, C].
* Growths are in sides (the largest) of P's box, all at least 0, ordered x-, x+, y-, y+, z-, z+.
* The network does not know which way objects face: its answer is the mean over four quarter turns
  about z, each mirrored or not.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file
from torch import Tensor, nn

WEIGHTS_FILE = "growth.safetensors"
_CELLS = 32
_MARGIN = 1.1
"""Side of the volume in sides of P's box."""
_WIDTHS = (16, 32, 64, 128)
FloatArray = NDArray[np.floating]


class GrowthNetwork(nn.Module):
    """Four strided stages, then two layers on all of the 2 x 2 x 2 cells left."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        before = 4 + 3
        for width in _WIDTHS:
            layers += [
                nn.Conv3d(before, width, 3, stride=2, padding=1),
                nn.GroupNorm(8, width),
                nn.SiLU(),
                nn.Conv3d(width, width, 3, padding=1),
                nn.GroupNorm(8, width),
                nn.SiLU(),
            ]
            before = width
        self.body = nn.Sequential(*layers)
        self.head = nn.Sequential(nn.Linear(before * 8, 192), nn.SiLU(), nn.Linear(192, 6))
        along = torch.linspace(-1, 1, _CELLS)
        place = torch.stack(torch.meshgrid(along, along, along, indexing="ij"))
        self.register_buffer("place", place, persistent=False)

    def forward(self, volume: Tensor) -> Tensor:  # [B, 4, C, C, C] -> [B, 6]
        """Return the growths, not bounded: where P ends with the object they lie about 0."""
        assert isinstance(self.place, Tensor)
        place = self.place.expand(len(volume), -1, -1, -1, -1)
        found: Tensor = self.head(self.body(torch.cat([volume, place], dim=1)).flatten(1))
        return found

    @torch.no_grad()
    def averaged(self, volume: Tensor) -> Tensor:  # [B, 4, C, C, C] -> [B, 6]
        """Return the mean over all orientations, at least 0."""
        total = torch.zeros(len(volume), 6)
        for k in range(8):
            turned, _ = oriented(volume, total, k % 4, k >= 4)
            total = total + _unoriented(self(turned), k % 4, k >= 4)
        return (total / 8).clamp_min(0.0)


def oriented(
    volume: Tensor,  # [B, 4, C, C, C]
    growth: Tensor,  # [B, 6]
    turns: int,
    mirror: bool,
) -> tuple[Tensor, Tensor]:
    """Turn P and the growths by quarter turns about z, then mirror x."""
    for _ in range(turns):
        volume = torch.rot90(volume, 1, dims=(-3, -2))
        filled, x, y, z = volume.unbind(1)
        volume = torch.stack([filled, -y, x, z], dim=1)
        growth = growth[:, [3, 2, 0, 1, 4, 5]]
    if mirror:
        volume = volume.flip(-3) * volume.new_tensor([1, -1, 1, 1]).view(4, 1, 1, 1)
        growth = growth[:, [1, 0, 2, 3, 4, 5]]
    return volume, growth


def _unoriented(growth: Tensor, turns: int, mirror: bool) -> Tensor:  # [B, 6]
    """Undo :func:`oriented` for growths."""
    if mirror:
        growth = growth[:, [1, 0, 2, 3, 4, 5]]
    for _ in range(turns):
        growth = growth[:, [2, 3, 1, 0, 4, 5]]
    return growth


def partial_volume(
    points: FloatArray,  # [N, 3]
    normals: FloatArray,  # [N, 3] outward
) -> NDArray[np.float32]:  # [4, C, C, C] in [-1, 1]
    """Return P's volume; see the module's conventions."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = max(float((high - low).max()), 1e-12) * _MARGIN
    place = (points - (low + high) / 2) / size + 0.5
    cells = np.clip((place * _CELLS).astype(np.int64), 0, _CELLS - 1)
    index = (cells[:, 0] * _CELLS + cells[:, 1]) * _CELLS + cells[:, 2]
    count = np.bincount(index, minlength=_CELLS**3)
    sums = [np.bincount(index, normals[:, k], _CELLS**3) for k in range(3)]
    volume = np.stack([(count > 0).astype(np.float64), *(s / np.maximum(count, 1) for s in sums)])
    return volume.reshape(4, _CELLS, _CELLS, _CELLS).astype(np.float32)


def guess_growth(
    points: FloatArray,  # [N, 3] of P, z up
    normals: FloatArray,  # [N, 3] outward
) -> FloatArray:  # [6]
    """Return how far the complete object is believed to reach beyond P's box."""
    volume = torch.from_numpy(partial_volume(points, normals))[None]
    growth: FloatArray = packaged_network().averaged(volume)[0].double().numpy()
    return growth


@functools.cache
def packaged_network() -> GrowthNetwork:
    """Return the network with the weights of the package."""
    model = GrowthNetwork()
    model.load_state_dict(load_file(Path(__file__).parent / "weights" / WEIGHTS_FILE))
    return model.eval()
