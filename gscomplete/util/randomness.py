"""Random numbers as a function of (seed, step, purpose), so that a resumed run draws the same."""

from __future__ import annotations

import hashlib

import numpy as np
import torch


def generator_for(seed: int, step: int, purpose: str) -> torch.Generator:
    """Return a CPU generator that depends on nothing but its arguments."""
    digest = hashlib.blake2b(f"{seed}/{step}/{purpose}".encode(), digest_size=8).digest()
    generator = torch.Generator()
    generator.manual_seed(int.from_bytes(digest, "little") >> 1)
    return generator


def uniform(generator: torch.Generator, low: float, high: float) -> float:
    """Draw one number uniformly from [low, high)."""
    return low + (high - low) * float(torch.rand((), generator=generator, dtype=torch.float64))


def sphere_points(count: int, generator: torch.Generator) -> np.ndarray:  # [count, 3]
    """Draw points uniformly from the ball of radius 1."""
    direction = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    direction /= direction.norm(dim=1, keepdim=True).clamp_min(1e-12)
    radius = torch.rand(count, 1, generator=generator, dtype=torch.float64) ** (1 / 3)
    return (direction * radius).numpy()
