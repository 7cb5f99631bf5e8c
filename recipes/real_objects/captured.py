"""Captures of objects: photos of one side, splats trained from them, and the box about the object.

They have what trained captures have beside an object's surface: floaters, haze, large splats behind
the surface where no photo looks, and remains of what the object stands on.

Conventions
-----------
* A frame like the object frame: centred, z up, largest side about 1. All lengths are in its unit.
* Everything is a function of the object and of random numbers.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from gscomplete.render import render
from gscomplete.splats import Splats, colors_to_sh, concatenate
from gscomplete.splats.rotations import quaternions_facing
from gscomplete.util.arrays import Float64Array
from gscomplete.views.cameras import Cameras, orbit_cameras
from splatcomplete_data.cuts.geometry import by_visibility, splat_points
from splatcomplete_data.multiview.photos.images import View
from splatcomplete_data.multiview.training.initial import initial_splats
from splatcomplete_data.multiview.training.settings import GrowthSettings, TrainingSettings
from splatcomplete_data.multiview.training.train import Training
from splatcomplete_data.scan.cloud import PointCloud

STEPS = 1200
"""Of the training."""
_SIZE_PX, _FOV_DEG, _DISTANCE = 192, 45.0, 1.9
"""Photos are square; their cameras look at the object's middle from this far."""
_ELEVATIONS_DEG, _PER_ELEVATION = (6.0, 18.0, 32.0), 12
_HALF_ARC_DEG = (20.0, 60.0)
"""Photos are taken on both sides of the middle up to so far, which is drawn."""
_UNSTEADY_DEG, _NOISE = 4.0, 0.012
"""Elevations vary by up to the first; the second is the standard deviation of colours in [0, 1]."""
_TABLE_SPLATS, _TABLE_HALF, _TABLE_BELOW = 15_000, 1.3, 0.002
_ROOM_SPLATS, _ROOM_RADIUS = 10_000, 5.0
_WAVES = 10
"""So many sine waves make a pattern."""
_OBJECT_POINTS, _TABLE_POINTS, _ROOM_POINTS, _POINT_NOISE = 3000, 2000, 1500, 0.004
"""The cloud that training starts from, as structure from motion finds it."""
_MOST_SPLATS = 30_000
_MARGIN, _ABOVE_TABLE = 0.02, 0.008
"""The box reaches so far beyond the object, and starts so high above its lowest place."""


def captured_part(complete: Splats, rng: np.random.Generator, steps: int = STEPS) -> Splats:
    """Return what a capture from one side keeps of an object (about a minute on one core).

    Args:
        complete: the object; it hides what is behind it.
        rng: draws the surroundings, the photos and their noise.
        steps: of the training.
    """
    points = splat_points(complete)
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2
    table = _table(middle, float(low[2]), rng)
    room = _room(middle, rng)
    cameras, eyes = _cameras(middle, rng)
    views = _photos(concatenate([complete, table, room]), cameras, rng)
    is_seen = by_visibility(complete, eyes, fov_deg=_FOV_DEG).mask
    cloud = _cloud([complete.select(is_seen), table, room], rng)
    settings = TrainingSettings(
        steps=steps,
        seed=int(rng.integers(2**31)),
        growth=GrowthSettings(max_splats=_MOST_SPLATS),
    )
    initial, _ = initial_splats(cloud, settings)
    training = Training(views, initial, _DISTANCE, settings)
    while not training.finished:
        training.step()
    trained = training.splats()
    low, high = low - _MARGIN, high + _MARGIN
    low[2] += _MARGIN + _ABOVE_TABLE
    places = splat_points(trained)
    return trained.select(torch.from_numpy(((places >= low) & (places <= high)).all(axis=1)))


def _table(middle: Float64Array, low: float, rng: np.random.Generator) -> Splats:
    places = np.full((_TABLE_SPLATS, 3), low - _TABLE_BELOW)
    places[:, :2] = middle[:2] + rng.uniform(-1, 1, (_TABLE_SPLATS, 2)) * _TABLE_HALF
    up = np.tile((0.0, 0.0, 1.0), (_TABLE_SPLATS, 1))
    return _patterned(places, up, 2 * _TABLE_HALF / math.sqrt(_TABLE_SPLATS), rng)


def _room(middle: Float64Array, rng: np.random.Generator) -> Splats:
    ways = rng.standard_normal((_ROOM_SPLATS, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    spacing = _ROOM_RADIUS * math.sqrt(4 * math.pi / _ROOM_SPLATS)
    return _patterned(middle + _ROOM_RADIUS * ways, ways, spacing, rng)


def _patterned(
    places: Float64Array,  # [N, 3]
    normals: Float64Array,  # [N, 3] unit
    size: float,
    rng: np.random.Generator,
) -> Splats:
    """Cover a surface with discs in a colour that varies smoothly over some lengths."""
    colors = np.broadcast_to(rng.uniform(0.2, 0.8, 3), places.shape).copy()
    shares = (places - places.mean(axis=0)) / np.abs(places).max()
    for k in range(_WAVES):
        waves = shares @ rng.normal(0, 4.0 * (1 + k), 3) + rng.uniform(0, 2 * math.pi)
        colors += np.sin(waves)[:, None] * rng.normal(0, 0.12, 3)
    colors += rng.normal(0, 0.02, places.shape)
    scales = torch.tensor([size, size, 0.05 * size]).repeat(len(places), 1)
    return Splats(
        torch.from_numpy(places).float(),
        quaternions_facing(torch.from_numpy(normals).float()),
        scales,
        torch.full((len(places),), 0.99),
        colors_to_sh(torch.from_numpy(colors.clip(0, 1)).float()),
    )


def _cameras(
    middle: Float64Array, rng: np.random.Generator
) -> tuple[Cameras, Float64Array]:  # eyes [V, 3]
    """Place cameras on arcs of three elevations, not quite evenly."""
    half = float(rng.uniform(*_HALF_ARC_DEG))
    drawn = rng.uniform(size=(len(_ELEVATIONS_DEG), _PER_ELEVATION))
    along = (np.arange(_PER_ELEVATION) + drawn) / _PER_ELEVATION
    azimuths = rng.uniform(0, 360) + half * (2 * along - 1)
    unsteady = _UNSTEADY_DEG * rng.uniform(-1, 1, along.shape)
    elevations = np.array(_ELEVATIONS_DEG)[:, None] + unsteady
    cameras = orbit_cameras(
        torch.from_numpy(azimuths.ravel()),
        torch.from_numpy(elevations.ravel()),
        radius=_DISTANCE,
        fov_deg=_FOV_DEG,
        size_px=_SIZE_PX,
        target=torch.from_numpy(middle),
    )
    return cameras, cameras.positions.double().numpy()


def _photos(scene: Splats, cameras: Cameras, rng: np.random.Generator) -> list[View]:
    photos = []
    for k in range(len(cameras)):
        camera = cameras[k : k + 1]
        with torch.no_grad():
            color = render(scene, camera).color[0].double().numpy()
        noisy = (color + rng.normal(0, _NOISE, color.shape)).clip(0, 1)
        everywhere = np.full(color.shape[:2], 255, np.uint8)
        photos.append(
            View(str(k), camera, np.round(255 * noisy).astype(np.uint8), everywhere, None)
        )
    return photos


def _cloud(parts: list[Splats], rng: np.random.Generator) -> PointCloud:
    points, colors = [], []
    for part, most in zip(parts, (_OBJECT_POINTS, _TABLE_POINTS, _ROOM_POINTS), strict=True):
        rows = rng.permutation(len(part))[:most]
        places = splat_points(part)[rows]
        points.append(places + rng.normal(0, _POINT_NOISE, places.shape))
        colors.append(part.base_colors.numpy()[rows].clip(0, 1).astype(np.float32))
    return PointCloud(np.concatenate(points), np.concatenate(colors))
