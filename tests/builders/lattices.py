"""Points of things made of upright bars, in the plane y = 0."""

from __future__ import annotations

import numpy as np


def bars(*boxes: tuple[float, float, float, float]) -> np.ndarray:
    """Return points of upright bars: from and to across, from and to upwards; .02 thick."""
    step = 0.006
    parts = []
    for left, right, low, high in boxes:
        along = np.meshgrid(np.arange(left, right, step), np.arange(low, high, step))
        for depth in (-0.01, 0.01):
            parts.append(np.stack([along[0], np.full_like(along[0], depth), along[1]], -1))
    return np.concatenate([part.reshape(-1, 3) for part in parts])


PICKETS = bars(*((left, left + 0.02, -0.3, 0.3) for left in np.arange(-0.45, 0.45, 0.055)),
               (-0.46, 0.46, -0.3, -0.25), (-0.46, 0.46, 0.25, 0.3))  # fmt: skip
"""Gaps of .035, less than two cells of the network."""


def between_pickets() -> np.ndarray:
    """Return a point in the middle of each gap."""
    between = np.arange(-0.45, 0.39, 0.055) + 0.0375
    return np.stack([between, np.zeros_like(between), np.zeros_like(between)], axis=1)
