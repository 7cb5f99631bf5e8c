"""The splat record: one immutable set of Gaussian splats with activated values.

Conventions
-----------
* N splats; K spherical-harmonic coefficients per channel, K = (degree + 1)^2 in {1, 4, 9, 16}.
* ``quaternions`` are (w, x, y, z), unit length, rotating splat axes into the frame of ``means``.
* ``scales`` are standard deviations along the splat's axes (linear, not logarithms).
* ``opacities`` lie in [0, 1] (not logits).
* ``sh[:, 0]`` is the base colour band: colour = 0.5 + SH_C0 * sh[:, 0], sRGB as stored in files.

Logits and logarithms exist only in files (``ply``) and in the optimiser's parameters.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

SH_C0 = 0.28209479177387814
"""Value of the constant spherical harmonic, 1 / (2 sqrt(pi))."""


@dataclass(frozen=True, slots=True)
class Splats:
    """An immutable set of N Gaussian splats. All fields share one device and dtype."""

    means: Tensor  # [N, 3]
    quaternions: Tensor  # [N, 4] wxyz, unit
    scales: Tensor  # [N, 3] standard deviations
    opacities: Tensor  # [N] in [0, 1]
    sh: Tensor  # [N, K, 3]

    def __post_init__(self) -> None:
        """Check that the shapes fit together.

        Raises:
            ValueError: a field's shape does not match ``means``, or K is not 1, 4, 9 or 16.
        """
        count = self.means.shape[0]
        expected: dict[str, tuple[int, ...]] = {
            "means": (count, 3),
            "quaternions": (count, 4),
            "scales": (count, 3),
        }
        expected["opacities"] = (count,)
        for name, shape in expected.items():
            found = tuple(getattr(self, name).shape)
            if found != shape:
                raise ValueError(f"Splats.{name}: expected shape {shape}, found {found}")
        if self.sh.ndim != 3 or self.sh.shape[0] != count or self.sh.shape[2] != 3:
            raise ValueError(f"Splats.sh: expected ({count}, K, 3), found {tuple(self.sh.shape)}")
        if self.sh.shape[1] not in (1, 4, 9, 16):
            raise ValueError(f"Splats.sh: K must be 1, 4, 9 or 16, found {self.sh.shape[1]}")

    def __len__(self) -> int:
        """Return the number of splats."""
        return int(self.means.shape[0])

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return math.isqrt(self.sh.shape[1]) - 1

    @property
    def base_colors(self) -> Tensor:  # [N, 3]
        """Colours of the constant band, usually but not necessarily in [0, 1]."""
        return 0.5 + SH_C0 * self.sh[:, 0]

    @property
    def typical_size(self) -> float:
        """Median over the splats of their largest scale: one alone may be of any size."""
        return float(self.scales.amax(dim=1).median())

    def fields(self) -> Iterator[tuple[str, Tensor]]:
        """Yield (name, tensor) for every field in declaration order."""
        for field in dataclasses.fields(self):
            yield field.name, getattr(self, field.name)

    def select(self, index: Tensor) -> Splats:
        """Return the splats picked by a boolean mask [N] or integer indices [M]."""
        return Splats(**{name: value[index] for name, value in self.fields()})

    def to(
        self, device: torch.device | str | None = None, dtype: torch.dtype | None = None
    ) -> Splats:
        """Return the splats on another device or in another floating dtype."""
        return Splats(**{name: v.to(device=device, dtype=dtype) for name, v in self.fields()})

    def detach(self) -> Splats:
        """Return the splats cut from the autograd graph."""
        return Splats(**{name: value.detach() for name, value in self.fields()})

    def as_read(self) -> Splats:
        """Return the splats as a file gives them, for NumPy: on the CPU and without gradients.

        Types of fewer bits than float32, which NumPy may lack, become float32.
        """
        dtype = torch.promote_types(self.means.dtype, torch.float32)
        return self.detach().to("cpu", dtype)

    def with_sh_degree(self, degree: int) -> Splats:
        """Return the splats with bands above ``degree`` dropped, or missing bands as zeros."""
        bands = (degree + 1) ** 2
        kept = self.sh[:, :bands]
        missing = bands - kept.shape[1]
        if missing > 0:
            kept = torch.cat([kept, kept.new_zeros(len(self), missing, 3)], dim=1)
        return dataclasses.replace(self, sh=kept)

    def bounds(self) -> tuple[Tensor, Tensor]:  # [3], [3]
        """Return the corners of the axis-aligned box of the means.

        Raises:
            ValueError: there are no splats.
        """
        if len(self) == 0:
            raise ValueError("Splats.bounds: no splats, so no box")
        return self.means.amin(dim=0), self.means.amax(dim=0)


def concatenate(parts: Sequence[Splats]) -> Splats:
    """Join splat sets in order; the result has the highest SH degree among them.

    Args:
        parts: at least one set of splats, all in one frame.

    Returns:
        All rows; harmonics of lower degree are filled up with zeros.

    Raises:
        ValueError: ``parts`` is empty.
    """
    if not parts:
        raise ValueError("concatenate: expected at least one splat set, found none")
    degree = max(part.sh_degree for part in parts)
    parts = [part.with_sh_degree(degree) for part in parts]
    names = [field.name for field in dataclasses.fields(Splats)]
    return Splats(**{name: torch.cat([getattr(p, name) for p in parts]) for name in names})


def colors_to_sh(colors: Tensor) -> Tensor:  # [N, 3] -> [N, 1, 3]
    """Turn colours into degree-0 spherical-harmonic coefficients.

    Args:
        colors: [N, 3] red, green, blue in [0, 1].

    Returns:
        [N, 1, 3] coefficients of the constant band: (colour - 0.5) / 0.2821 (Kerbl et al. 2023).
    """
    return ((colors - 0.5) / SH_C0)[:, None, :]
