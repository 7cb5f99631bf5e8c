"""A ball of splats to cut."""

import math

import numpy as np

from gscomplete.splats.record import Splats
from splatcomplete_data.mesh.discs import discs_at


def ball(count: int = 4000, radius: float = 0.5) -> Splats:
    """Return discs on a sphere (Fibonacci points)."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    angle = np.pi * (1 + math.sqrt(5)) * k
    ring = np.sqrt(1 - z * z)
    normals = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1).astype(np.float32)
    spacing = math.sqrt(4 * math.pi * radius**2 / count)
    return discs_at(normals * np.float32(radius), normals, np.abs(normals), spacing)


BALL = ball()
