"""Similarity transforms of points and of splats; linear maps that stretch splats.

Conventions
-----------
* A similarity maps x to scale * rotation @ x + translation, held in float64 on the CPU.
* Names say target and source: ``object_from_file.apply(points)`` takes points in the file frame
  to the object frame; ``a_from_b.compose(b_from_c)`` is ``a_from_c``.
* Rotations are proper: splats cannot be mirrored without changing what their harmonics mean.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from gscomplete.splats.record import Splats
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.splats.sh import rotate_sh

ROTATION_TOLERANCE = 1e-6
"""Largest entry of R R^T - I that still passes as a rotation."""


@dataclass(frozen=True, slots=True, eq=False)
class Similarity:
    """x -> scale * rotation @ x + translation."""

    scale: float
    rotation: Tensor  # [3, 3] float64, proper
    translation: Tensor  # [3] float64

    def __post_init__(self) -> None:
        """Convert to float64 on the CPU and check.

        Raises:
            ValueError: the scale is not positive and finite, the matrix is not a proper rotation,
                or the translation is not finite.
        """
        rotation = torch.as_tensor(self.rotation).detach().to("cpu", torch.float64)
        translation = torch.as_tensor(self.translation).detach().to("cpu", torch.float64)
        object.__setattr__(self, "scale", float(self.scale))
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)
        if not (math.isfinite(self.scale) and self.scale > 0):
            raise ValueError(f"Similarity.scale: expected a positive number, found {self.scale}")
        if rotation.shape != (3, 3) or translation.shape != (3,):
            shapes = f"{tuple(rotation.shape)} and {tuple(translation.shape)}"
            raise ValueError(f"Similarity: expected shapes (3, 3) and (3,), found {shapes}")
        unit = torch.eye(3, dtype=torch.float64, device="cpu")
        error = (rotation @ rotation.T - unit).abs().max()
        if not (error <= ROTATION_TOLERANCE and torch.linalg.det(rotation) > 0):
            raise ValueError(f"Similarity.rotation: not a proper rotation: {rotation.tolist()}")
        if not bool(torch.isfinite(translation).all()):
            raise ValueError(f"Similarity.translation: not finite: {translation.tolist()}")

    def apply(self, points: Tensor) -> Tensor:  # [..., 3] -> [..., 3]
        """Transform points, computing in float64; keeps their dtype and device."""
        matrix = (self.scale * self.rotation.T).to(points.device)
        moved = points.to(torch.float64) @ matrix + self.translation.to(points.device)
        return moved.to(points.dtype)

    def inverse(self) -> Similarity:
        """Return the similarity that undoes this one."""
        back = self.rotation.T
        return Similarity(1 / self.scale, back, -(back @ self.translation) / self.scale)

    def compose(self, inner: Similarity) -> Similarity:
        """Return the similarity that applies ``inner`` first, then this one."""
        return Similarity(
            self.scale * inner.scale,
            self.rotation @ inner.rotation,
            self.apply(inner.translation),
        )

    def to_json(self) -> dict[str, Any]:
        """Return the JSON form; ``from_json`` gives the same bits back."""
        return {
            "scale": self.scale,
            "rotation": self.rotation.tolist(),
            "translation": self.translation.tolist(),
        }

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Similarity:
        """Build a similarity from its JSON form.

        Raises:
            ValueError: a key is missing, or a value is not what it should be.
        """
        try:
            rotation = torch.tensor(data["rotation"], dtype=torch.float64)
            translation = torch.tensor(data["translation"], dtype=torch.float64)
            return Similarity(float(data["scale"]), rotation, translation)
        except (KeyError, TypeError) as error:
            expected = "scale (number), rotation (3 x 3), translation (3)"
            raise ValueError(f"similarity: expected {expected}, found {data!r}") from error


def quaternions_from_rotations(rotations: Tensor) -> Tensor:  # [N, 3, 3] -> [N, 4]
    """Return the unit quaternions (w, x, y, z), w >= 0, of rotation matrices, in float64.

    A quaternion's outer product with itself is linear in the matrix; the column with the largest
    diagonal entry is the quaternion times its largest component, so nothing is divided by less than
    1/2.
    """
    a, b, c, d, e, f, g, h, i = rotations.to(torch.float64).flatten(1).unbind(1)
    rows = (
        (1 + a + e + i, h - f, c - g, d - b),
        (h - f, 1 + a - e - i, b + d, c + g),
        (c - g, b + d, 1 - a + e - i, f + h),
        (d - b, c + g, f + h, 1 - a - e + i),
    )
    outer = torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
    largest = outer.diagonal(dim1=1, dim2=2).argmax(dim=1)
    column = outer[torch.arange(len(outer)), largest]
    unit = column / column.norm(dim=1, keepdim=True)
    return torch.where(unit[:, :1] < 0, -unit, unit)


def quaternion_from_rotation(rotation: Tensor) -> Tensor:  # [3, 3] -> [4]
    """Return the quaternion of one rotation matrix; see :func:`quaternions_from_rotations`."""
    return quaternions_from_rotations(rotation[None])[0]


def multiply_quaternions(a: Tensor, b: Tensor) -> Tensor:  # [..., 4], [..., 4] -> [..., 4]
    """Hamilton product: the rotation that applies ``b`` first, then ``a``."""
    aw, ax, ay, az = a.unbind(-1)
    bw, bx, by, bz = b.unbind(-1)
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        dim=-1,
    )


def transform_splats(splats: Splats, similarity: Similarity) -> Splats:
    """Move splats to another frame: means, quaternions, scales and harmonics.

    Opacities stay. Views of the result from transformed cameras equal views of the original.

    Args:
        splats: N splats in one frame.
        similarity: that frame to the other.

    Returns:
        N splats in the other frame, row by row.
    """
    turn = quaternion_from_rotation(similarity.rotation).to(splats.quaternions)
    return Splats(
        means=similarity.apply(splats.means),
        quaternions=multiply_quaternions(turn, splats.quaternions),
        scales=(splats.scales.to(torch.float64) * similarity.scale).to(splats.scales.dtype),
        opacities=splats.opacities,
        sh=rotate_sh(splats.sh, similarity.rotation),
    )


def stretch_splats(splats: Splats, matrix: Tensor) -> Splats:  # [3, 3] invertible
    """Map splats linearly, by different factors along different axes.

    Gaussians remain Gaussians. Harmonics stay as they are, and eigenvectors of equal eigenvalues
    may be any: the third axis is the thinnest one.

    Args:
        splats: N splats.
        matrix: takes their means to the new ones.

    Returns:
        N splats, row by row.
    """
    given = torch.as_tensor(matrix).to("cpu", torch.float64)
    axes = rotation_matrices(splats.quaternions.to(torch.float64))
    spread = given @ axes @ torch.diag_embed(splats.scales.to(torch.float64))
    variances, turned = torch.linalg.eigh(spread @ spread.transpose(1, 2))
    turned = turned.flip(2)
    turned[:, :, 2] *= torch.linalg.det(turned)[:, None]  # a reflection becomes a rotation
    return Splats(
        means=(splats.means.to(torch.float64) @ given.T).to(splats.means.dtype),
        quaternions=quaternions_from_rotations(turned).to(splats.quaternions.dtype),
        scales=variances.flip(1).clamp_min(0.0).sqrt().to(splats.scales.dtype),
        opacities=splats.opacities,
        sh=splats.sh,
    )
