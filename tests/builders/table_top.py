"""A synthetic table-top scan: what a camera in front sees of boxes and cups on a table."""

from __future__ import annotations

import numpy as np

from splatcomplete_data.scan.cloud import PointCloud

EYE = np.array([0.0, -1.2, 1.0])
SPACING = 0.006


def _grid(origin, first, second):
    """Spread points over a parallelogram, SPACING apart."""
    first, second = np.asarray(first, float), np.asarray(second, float)
    counts = [max(2, int(np.linalg.norm(side) / SPACING)) for side in (first, second)]
    u, v = ((np.arange(count) + 0.5) / count for count in counts)
    flat = np.stack(np.meshgrid(u, v, indexing="ij"), -1).reshape(-1, 2)
    return np.asarray(origin) + flat @ np.stack([first, second])


def box(center, size, turn_deg=0.0):
    """Return what the camera sees of a box on the table: its top and its two near sides."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    x, y = np.array([c, s, 0]) * size[0], np.array([-s, c, 0]) * size[1]
    up = np.array([0, 0, size[2]])
    foot = np.array([*center, 0.0]) - x / 2 - y / 2
    faces = [(foot + up, x, y, up), (foot, x, up, -y), (foot + y, x, up, y)]
    faces += [(foot, y, up, -x), (foot + x, y, up, x)]
    seen = [_grid(o, a, b) for o, a, b, normal in faces if (EYE - o - a / 2 - b / 2) @ normal > 0]
    return np.concatenate(seen)


def table_top(parts, seed=0, noise=0.001):
    """Return a cloud of a table and ``parts``, with labels 0 for the table and 1, 2, ... ."""
    rng = np.random.default_rng(seed)
    points = [_grid([-0.6, -0.6, 0], [1.2, 0, 0], [0, 1.2, 0]), *parts]
    labels = np.repeat(np.arange(len(points)), [len(part) for part in points])
    stacked = np.concatenate(points) + rng.normal(0, noise, (len(labels), 3))
    colors = np.full(stacked.shape, 0.6, np.float32)
    return PointCloud(stacked, colors, labels)


def cup(center, radius, height):
    """Return what the camera sees of an open cup: its near outer side and its far inner side."""
    around = np.arange(0, 2 * np.pi, SPACING / radius)
    angle, z = (grid.reshape(-1) for grid in np.meshgrid(around, np.arange(0, height, SPACING)))
    out = np.stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))], axis=1)
    points = np.array([*center, 0.0]) + radius * out + np.outer(z, [0, 0, 1])
    to_eye = EYE - points
    is_outer = (out * to_eye).sum(axis=1) > 0
    # the sight line from the inner side leaves the cup at its other side, above the rim or not
    across = -2 * radius * (out * to_eye).sum(axis=1) / np.square(to_eye[:, :2]).sum(axis=1)
    return points[is_outer | (z + across * to_eye[:, 2] > height)]
