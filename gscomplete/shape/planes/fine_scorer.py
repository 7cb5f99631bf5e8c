"""Predict how well a plane's copy of P matches the truth, from P's voxels folded about the plane.

``coarse_scorer`` reads 21 numbers per plane and can afford all 1,332 planes. This scorer reads the
voxels themselves, for the few planes that the coarse one prefers, and corrects its scores. It was
trained on procedural objects whose truth is known (``recipes/train_embedded_prior``).

Conventions
-----------
* In a plane's frame u is the distance from the plane, v runs along it (horizontal), z is up; cells
  have the side ``STEP`` in object sizes. The first half of the channels is the side that the normal
  points to, the second half the other side.
* Fine volumes hold occupancy and colour times occupancy; coarse ones, of half the resolution, the
  views' evidence (in front, behind, beside).
* The file holds float16 tensors under the network's own names.
"""

from __future__ import annotations

import functools
import hashlib
import math
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
import torch
import torch.nn.functional as F
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor, nn

from gscomplete.errors import UserError
from gscomplete.networks.packaged import PACKAGED_WEIGHTS
from gscomplete.shape.planes.features import FEATURES
from gscomplete.shape.voxels import CELL_SIDE, HALF_SIDE
from gscomplete.util.arrays import Float32Array
from gscomplete.util.atomic import atomic_path
from gscomplete.util.kernels import KERNEL
from gscomplete.util.same_bits import GroupNorm, fixed_silu

FINE_SCORER_FILE = "plane_judge.safetensors"
STEP = 0.04
SIZE = (18, 36, 28)
"""Cells along u, v, z."""
_WIDTHS = (32, 64, 128)
_EVIDENCE_WIDTH = 8
_HIDDEN = 128
_GROUPS = 8


@dataclass(frozen=True, slots=True)
class FoldedVolumes:
    """P on both sides of each of K planes."""

    fine: Tensor  # [K, 8, U, V, Z]
    coarse: Tensor  # [K, 6, U/2, V/2, Z/2]


class ResidualBlock(nn.Module):
    """Two convolutions added to the identity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm_in = GroupNorm(_GROUPS, width)
        self.conv_in = nn.Conv3d(width, width, 3, padding=1)
        self.norm_out = GroupNorm(_GROUPS, width)
        self.conv_out = nn.Conv3d(width, width, 3, padding=1)
        nn.init.zeros_(self.conv_out.weight)

    def forward(self, x: Tensor) -> Tensor:  # [K, C, u, v, z]
        """Return the features after the block."""
        h = self.conv_in(fixed_silu(self.norm_in(x)))
        return x + self.conv_out(fixed_silu(self.norm_out(h)))


class FineSymmetryScorer(nn.Module):
    """Scores planes one by one."""

    center: Tensor
    spread: Tensor

    def __init__(self) -> None:
        super().__init__()
        w = _WIDTHS
        self.stem = nn.Conv3d(8, w[0] - _EVIDENCE_WIDTH, 3, stride=2, padding=1)
        self.evidence = nn.Conv3d(6, _EVIDENCE_WIDTH, 1)
        self.blocks = nn.ModuleList(ResidualBlock(width) for width in w)
        self.shrink = nn.ModuleList(
            nn.Conv3d(w[i], w[i + 1], 3, stride=2, padding=1) for i in range(2)
        )
        self.norm = GroupNorm(_GROUPS, w[2])
        self.register_buffer("center", torch.zeros(len(FEATURES)))
        self.register_buffer("spread", torch.ones(len(FEATURES)))
        answer = nn.Linear(_HIDDEN, 2)
        nn.init.zeros_(answer.weight)
        self.head = nn.Sequential(nn.Linear(2 * w[2] + len(FEATURES), _HIDDEN), nn.SiLU(), answer)
        self.trust = nn.Parameter(torch.tensor([0.6]))

    def forward(
        self,
        volumes: FoldedVolumes,
        features: Tensor,  # [K, F] of ``planes.features``
        ranked: Tensor,  # [K] the coarse scorer's logits
    ) -> tuple[Tensor, Tensor]:  # [K] logits of being the best, [K] scores
        """Score planes."""
        x = torch.cat([self.stem(volumes.fine), self.evidence(volumes.coarse)], dim=1)
        for level, block in enumerate(self.blocks):
            x = block(x if level == 0 else self.shrink[level - 1](fixed_silu(x)))
        x = fixed_silu(self.norm(x)).float()
        scaled = (features - self.center) / self.spread
        pooled = [x.mean(dim=(2, 3, 4)), x.amax(dim=(2, 3, 4)), scaled]
        answer = self.head(torch.cat(pooled, dim=1))
        return answer[:, 0] + self.trust * ranked, answer[:, 1]

    def digest(self) -> str:
        """Return a digest of the weights, which identifies data sets that were made with them."""
        return hashlib.sha256(save(self._stored())).hexdigest()[:12]

    def save(self, path: Path) -> None:
        """Write the network to a file."""
        with atomic_path(path) as temporary:
            temporary.write_bytes(save(self._stored()))

    def _stored(self) -> dict[str, Tensor]:
        return {k: v.detach().half().contiguous() for k, v in self.state_dict().items()}

    @classmethod
    def load(cls, path: Path) -> FineSymmetryScorer:
        """Read a network, for evaluation.

        Raises:
            UserError: the file is missing, damaged, or of another network.
        """
        with torch.device("meta"):  # weights that are not drawn leave the caller's random state
            scorer = cls()
        try:
            state = {k: v.float() for k, v in load_file(path).items()}
            scorer.load_state_dict(state, assign=True)
        except (SafetensorError, OSError) as error:
            raise UserError(f"{path}: expected a safetensors file ({error})") from error
        except RuntimeError as error:
            raise UserError(
                f"{path}: expected tensors of the fine symmetry scorer: {error}"
            ) from error
        return scorer.eval().requires_grad_(False)


@functools.cache
def packaged_fine_scorer() -> FineSymmetryScorer:
    """Return the network that ships with the package."""
    return FineSymmetryScorer.load(PACKAGED_WEIGHTS / FINE_SCORER_FILE)


def folded_volumes(
    cells: Float32Array,  # [N, 7] centre, colour, occupancy of P's cells
    evidence: Float32Array,  # [3, C/2, C/2, C/2]
    angles: Float32Array,  # [K] radians, azimuths of the planes' normals
    offsets: Float32Array,  # [K]
) -> FoldedVolumes:
    """Resample P's cells and evidence into the frame of each plane."""
    fine = torch.from_numpy(_folded(cells, angles, offsets))
    return FoldedVolumes(fine, _folded_evidence(evidence, angles, offsets))


def colored_cells(volume: Float32Array) -> Float32Array:  # [4, C, C, C] -> [N, 7]
    """List the filled cells of P: centre, colour, occupancy."""
    filled = np.argwhere(volume[0] > 0)
    x, y, z = filled.T
    centers = (filled + 0.5) * CELL_SIDE - HALF_SIDE
    parts = [centers, volume[1:, x, y, z].T, volume[0, x, y, z][:, None]]
    return np.concatenate(parts, axis=1, dtype=np.float32)


def _folded_evidence(
    evidence: Float32Array, angles: Float32Array, offsets: Float32Array
) -> Tensor:  # [K, 6, U/2, V/2, Z/2]
    """Look the evidence up at the coarse cells of every plane's frame."""
    step, (nu, nv, nz) = 2 * STEP, (n // 2 for n in SIZE)
    u = (torch.arange(nu) + 0.5) * step
    v = (torch.arange(nv) - (nv - 1) / 2) * step
    z = (torch.arange(nz) - (nz - 1) / 2) * step
    u, v, z = torch.meshgrid(u, v, z, indexing="ij")
    place = torch.from_numpy(offsets)[:, None, None, None]
    across = torch.stack([place + u, place - u], dim=1)  # [K, 2, U/2, V/2, Z/2]
    angle = torch.from_numpy(angles)[:, None, None, None, None]
    x = across * angle.cos() - v * angle.sin()
    y = across * angle.sin() + v * angle.cos()
    points = torch.stack([z.expand_as(x), y, x], dim=-1) / HALF_SIDE  # as grid_sample wants them
    found = F.grid_sample(
        torch.from_numpy(evidence)[None], points.reshape(1, -1, 1, 1, 3), align_corners=False
    )
    return found.reshape(3, *x.shape).permute(1, 2, 0, 3, 4, 5).flatten(1, 2)


def _folded(
    cells: Float32Array,  # [N, 7]
    angles: Float32Array,  # [K]
    offsets: Float32Array,  # [K]
) -> Float32Array:  # [K, 8, U, V, Z]
    """Spread cells over the eight cells nearest to them in every plane's frame."""
    out = np.zeros((len(angles), 2, 4, math.prod(SIZE)), np.float32)
    spread_cells(cells, angles, offsets, *SIZE, out)
    occupancy = np.maximum(out[:, :, :1], np.float32(1))  # at most 1 is kept, of colours as much
    out /= occupancy
    return out.reshape(len(angles), 8, *SIZE)


@numba.njit(**KERNEL)
def spread_cells(
    cells: Float32Array,  # [N, 7]
    angles: Float32Array,  # [K]
    offsets: Float32Array,  # [K]
    nu: int,
    nv: int,
    nz: int,
    out: Float32Array,  # [K, 2, 4, U V Z] zeros, added to
) -> None:
    """Sum occupancy, and colours times occupancy, on both sides of every plane."""
    for k in range(len(angles)):
        nx, ny = math.cos(angles[k]), math.sin(angles[k])
        for n in range(len(cells)):
            away = cells[n, 0] * nx + cells[n, 1] * ny - offsets[k]
            side = 0 if away >= 0 else 1
            u = abs(away) / STEP - 0.5
            v = (cells[n, 1] * nx - cells[n, 0] * ny) / STEP + 0.5 * (nv - 1)
            z = cells[n, 2] / STEP + 0.5 * (nz - 1)
            iu, iv, iz = math.floor(u), math.floor(v), math.floor(z)
            for corner in range(8):
                du, dv, dz = corner >> 2, (corner >> 1) & 1, corner & 1
                # Cells between the plane and the first layer count with the first layer.
                a, b, c = max(iu + du, 0), iv + dv, iz + dz
                if a >= nu or b < 0 or b >= nv or c < 0 or c >= nz:
                    continue
                share = abs(1 - du - (u - iu)) * abs(1 - dv - (v - iv)) * abs(1 - dz - (z - iz))
                weight = np.float32(share) * cells[n, 6]
                place = (a * nv + b) * nz + c
                out[k, side, 0, place] += weight
                for channel in range(3):
                    out[k, side, 1 + channel, place] += weight * cells[n, 3 + channel]
