"""A smooth solid whose surface follows splats: Poisson reconstruction, solved by Fourier transform.

Kazhdan et al. 2006 look for the function whose gradient matches the surface's normals. On a
periodic grid the Poisson equation for it becomes a division in the frequency domain (Peng et al.
2021). Where there are no splats, the surface continues smoothly.

Conventions
-----------
* The grid is a cube about the object frame's origin, of half side ``HALF_SIDE``; values are at the
  centres of its cells, positive inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from gscomplete.util.arrays import Float32Array, Float64Array

GRID = 128
HALF_SIDE = 0.72
CELL_SIDE = 2 * HALF_SIDE / GRID
_BLUR_CELLS = 1.5
_NEWTON_STEPS = 6
_NEAR_CELLS = 0.6
"""A cell is on the surface if its centre is nearer to it."""


@dataclass(frozen=True, slots=True)
class Solid:
    """The function on the grid, and its slopes."""

    field: Tensor  # [4, GRID, GRID, GRID] value, d/dx, d/dy, d/dz

    def sample(self, points: Tensor) -> Tensor:  # [N, 3] -> [N, 4]
        """Interpolate value and slopes."""
        place = (points / HALF_SIDE).flip(-1)[None, None, None]
        found = F.grid_sample(self.field[None], place, align_corners=False, padding_mode="border")
        return found[0, :, 0, 0].T

    def height(self, points: Tensor) -> Tensor:  # [N, 3] -> [N]
        """Return signed distances from the surface, positive outside, at most two cells."""
        found = self.sample(points)
        steep = found[:, 1:].norm(dim=1).clamp_min(1e-6)
        return (-found[:, 0] / steep).clamp(-2 * CELL_SIDE, 2 * CELL_SIDE)

    def project(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Move points [N, 3] to the surface; return them, outward normals, and which arrived."""
        home = points
        for _ in range(_NEWTON_STEPS):
            found = self.sample(points)
            slope = found[:, 1:]
            step = -found[:, :1] * slope / slope.square().sum(dim=1, keepdim=True).clamp_min(1e-12)
            points = points + step.clamp(-CELL_SIDE, CELL_SIDE)
        found = self.sample(points)
        steep = found[:, 1:].norm(dim=1).clamp_min(1e-6)
        near = (points - home).norm(dim=1) < 2.5 * CELL_SIDE
        arrived = near & (found[:, 0].abs() / steep < 0.1 * CELL_SIDE)
        return points, -F.normalize(found[:, 1:], dim=1), arrived

    def crossed_cells(self) -> Tensor:  # [M, 3]
        """Return the centres of the cells that the surface passes near."""
        value, x, y, z = self.field
        near = value * value < (_NEAR_CELLS * CELL_SIDE) ** 2 * (x * x + y * y + z * z)
        cells = (torch.nonzero(near).float() + 0.5) * CELL_SIDE - HALF_SIDE
        _, _, arrived = self.project(cells)  # flat places far from any surface are no surface
        return cells[arrived]


def solid_through(
    points: Tensor,  # [N, 3]
    normals: Tensor,  # [N, 3] outward
    areas: Tensor,  # [N]
) -> Solid:
    """Return the solid whose surface follows points.

    Args:
        points: on the surface, object frame.
        normals: there, outward, as long as they are sure.
        areas: of the surface that each stands for.
    """
    vectors = (-normals * areas[:, None]).numpy().astype(np.float64)
    spread = np.stack([_spread(points.numpy(), column) for column in vectors.T])
    frequencies = np.fft.fftfreq(GRID, CELL_SIDE) * 2 * np.pi
    half = np.fft.rfftfreq(GRID, CELL_SIDE) * 2 * np.pi
    waves = np.meshgrid(frequencies, frequencies, half, indexing="ij")
    squared = sum(wave * wave for wave in waves)
    squared[0, 0, 0] = 1.0
    divergence = sum(1j * w * np.fft.rfftn(v) for w, v in zip(waves, spread, strict=True))
    blur = np.exp(-0.5 * squared * (_BLUR_CELLS * CELL_SIDE) ** 2)
    values = np.fft.irfftn(-divergence / squared * blur, s=(GRID,) * 3, axes=(0, 1, 2))
    field = torch.from_numpy(values.astype(np.float32))
    solid = Solid(torch.stack([field, *torch.gradient(field, spacing=CELL_SIDE)]))
    weight = (areas * normals.norm(dim=1)).numpy().astype(np.float64)
    level = (solid.sample(points)[:, 0].numpy() * weight).sum() / max(weight.sum(), 1e-12)
    solid.field[0] -= float(level)  # numpy's sums do not depend on the number of threads
    return solid


def _spread(points: Float32Array, values: Float64Array) -> Float64Array:
    """Add values [N] at points [N, 3] to the eight cells about each, by nearness."""
    place = (points.astype(np.float64) + HALF_SIDE) / CELL_SIDE - 0.5
    corner = np.floor(place).astype(np.int64)
    share = place - corner
    grid = np.zeros(GRID**3)
    for number in range(8):
        step = np.array([number >> axis & 1 for axis in range(3)])
        weight = np.where(step, share, 1 - share).prod(axis=1) * values
        cell = np.clip(corner + step, 0, GRID - 1)
        flat = (cell[:, 0] * GRID + cell[:, 1]) * GRID + cell[:, 2]
        grid += np.bincount(flat, weight, minlength=GRID**3)
    return grid.reshape(GRID, GRID, GRID)
