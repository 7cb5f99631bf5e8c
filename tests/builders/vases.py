"""Surfaces of revolution for tests: a vase with a foot, and its parts."""

from __future__ import annotations

import numpy as np

from gscomplete.util.arrays import Float64Array

HEIGHT, HANDLE_RADIUS = 0.9, 0.42


def vase_radius(height: Float64Array) -> Float64Array:  # [N] in [0, HEIGHT] -> [N]
    """Return the radius of the wall at each height."""
    return 0.22 + 0.08 * np.sin(7.0 * height)


def vase(
    count: int = 12_000,
    azimuths_deg: tuple[float, float] = (0.0, 360.0),
    flattened: float = 1.0,
    seed: int = 0,
) -> Float64Array:  # [N, 3]
    """Return points on a vase about the z axis, between two azimuths; the foot is at z = 0.

    Args:
        count: points.
        azimuths_deg: the part that is kept.
        flattened: factor on y; with 1 the vase is round.
        seed: of the points' places.
    """
    random = np.random.default_rng(seed)
    height = random.uniform(0.0, HEIGHT, 4 * count)
    radius = vase_radius(height)
    height = height[random.uniform(0.0, 0.3, len(radius)) < radius][:count]
    radius = vase_radius(height)
    angle = np.deg2rad(random.uniform(*azimuths_deg, len(height)))
    return np.stack([radius * np.cos(angle), flattened * radius * np.sin(angle), height], axis=1)


def faceted(round_ones: Float64Array, folds: int) -> Float64Array:  # [N, 3] -> [N, 3]
    """Return points of something round moved inwards onto flat sides between its edges."""
    x, y, z = round_ones.T
    step = 2 * np.pi / folds
    aside = np.arctan2(y, x) % step - step / 2
    factor = np.cos(step / 2) / np.cos(aside)
    return np.stack([factor * x, factor * y, z], axis=1)


def handle(azimuth_deg: float, count: int = 800, seed: int = 1) -> Float64Array:  # [N, 3]
    """Return points on an upright rod beside the vase."""
    random = np.random.default_rng(seed)
    angle, around = np.deg2rad(azimuth_deg), random.uniform(0.0, 2 * np.pi, count)
    middle = HANDLE_RADIUS * np.array([np.cos(angle), np.sin(angle)])
    rod = middle + 0.025 * np.stack([np.cos(around), np.sin(around)], axis=1)
    return np.column_stack([rod, random.uniform(0.2, 0.7, count)])


def foot(azimuth_deg: float, height: float, count: int = 600, seed: int = 2) -> Float64Array:
    """Return points [N, 3] on a level rod that runs from inside the vase through its wall."""
    random = np.random.default_rng(seed)
    angle, around = np.deg2rad(azimuth_deg), random.uniform(0.0, 2 * np.pi, count)
    along = random.uniform(0.15, HANDLE_RADIUS, count)
    across = 0.03 * np.stack([np.cos(around), np.sin(around)])
    x = along * np.cos(angle) - across[0] * np.sin(angle)
    y = along * np.sin(angle) + across[0] * np.cos(angle)
    return np.stack([x, y, height + across[1]], axis=1)
