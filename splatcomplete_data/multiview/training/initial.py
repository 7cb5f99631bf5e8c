"""Splats to start the training from: a sparse cloud, or random points that the cameras see.

Conventions
-----------
* A point becomes a round splat as wide as the mean distance to its three nearest neighbours
  (Kerbl et al. 2023), opacity 0.1, with its own colour.
* Random points come from (seed): a box about what the cameras look at, kept where at least two
  cameras see them; their colour is the mean of the photos they project into.
* Where photos have object masks, points that a photo shows outside its mask are dropped: what is
  left lies within the object's visual hull.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy.spatial import cKDTree

from gscomplete.errors import UserError
from gscomplete.splats import Splats, colors_to_sh
from gscomplete.splats.thinning import thinned
from gscomplete.util.arrays import Float32Array, Float64Array, IntArray
from gscomplete.util.randomness import generator_for
from splatcomplete_data.multiview.photos.images import View
from splatcomplete_data.multiview.photos.posed import PosedPhotos
from splatcomplete_data.multiview.training.settings import TrainingSettings
from splatcomplete_data.scan import PointCloud

INITIAL_OPACITY = 0.1
NEIGHBOURS = 3
_FEWEST_POINTS = 50
"""Clouds smaller than this are too small to start from."""
_OBJECT_BOX, _SCENE_BOX = 0.6, 1.5
"""Half the box of random points, in mean camera distances, with object masks and without."""
_FAR_CAMERAS = 3.0
"""Points farther from what the cameras look at than this many camera distances are dropped."""


def splats_from_points(cloud: PointCloud) -> Splats:
    """Turn a cloud into splats.

    Raises:
        UserError: there are fewer than 50 distinct points.
    """
    unique, index = np.unique(cloud.points, axis=0, return_index=True)
    if len(unique) < _FEWEST_POINTS:
        raise UserError(
            f"initial points: expected at least {_FEWEST_POINTS} distinct points, found "
            f"{len(unique)}"
        )
    distances, _ = cKDTree(unique).query(unique, k=NEIGHBOURS + 1)
    width = np.sqrt(np.square(distances[:, 1:]).mean(axis=1))
    # A lone point far off would cover the picture: no splat starts wider than most.
    width = np.clip(width, 1e-7, np.quantile(width, 0.98))
    count = len(unique)
    quaternions = torch.zeros(count, 4)
    quaternions[:, 0] = 1.0
    colors = torch.from_numpy(np.ascontiguousarray(cloud.colors[index])).float()
    return Splats(
        torch.from_numpy(unique).float(),
        quaternions,
        torch.from_numpy(width).float()[:, None].repeat(1, 3),
        torch.full((count,), INITIAL_OPACITY),
        colors_to_sh(colors),
    )


def initial_splats(cloud: PointCloud, settings: TrainingSettings) -> tuple[Splats, tuple[str, ...]]:
    """Turn a cloud into no more splats than the training may have; return them and notes.

    Raises:
        UserError: there are fewer than 50 distinct points.
    """
    splats, most = splats_from_points(cloud), settings.growth.max_splats
    if len(splats) <= most:
        return splats, ()
    note = f"--max-splats {most:,}: an even choice of the {len(splats):,} initial splats"
    return thinned(splats, most, generator_for(settings.seed, 0, "initial")), (note,)


def near_points(cloud: PointCloud, capture: PosedPhotos) -> PointCloud:
    """Drop points much farther away than the cameras are from what they look at."""
    middle = capture.look_at()
    reach = float(np.linalg.norm(capture.positions - middle, axis=1).max())
    distance = np.linalg.norm(cloud.points - middle, axis=1)
    return cloud.select(distance <= _FAR_CAMERAS * reach)


def random_points(capture: PosedPhotos, views: Sequence[View], count: int, seed: int) -> PointCloud:
    """Draw random points that at least two cameras see, coloured by the photos.

    Raises:
        UserError: no point of the box is seen by two cameras.
    """
    rng = np.random.default_rng((seed, 21))
    middle = capture.look_at()
    reach = float(np.linalg.norm(capture.positions - middle, axis=1).mean())
    # An object lies within the cameras, not in the long shadow that its masks throw behind it.
    half = reach * (_OBJECT_BOX if views[0].alpha is not None else _SCENE_BOX)
    points, colors = np.zeros((0, 3)), np.zeros((0, 3), np.float32)
    for _ in range(40):
        drawn = middle + half * rng.uniform(-1.0, 1.0, (count, 3))
        times, outside, mean = _seen(drawn, views)
        kept = (times >= 2) & (outside == 0)
        points = np.concatenate([points, drawn[kept]])
        colors = np.concatenate([colors, mean[kept]])
        if len(points) >= count:
            return PointCloud(points[:count], colors[:count])
    raise UserError(
        f"{capture.source}: expected cameras that look at something in common, found no place that "
        "two of them see"
    )


def masked_points(cloud: PointCloud, views: Sequence[View]) -> PointCloud:
    """Drop points that a photo shows outside its object mask."""
    _, outside, _ = _seen(cloud.points, views)
    return cloud.select(outside == 0)


def _seen(
    points: Float64Array,  # [N, 3]
    views: Sequence[View],
) -> tuple[IntArray, IntArray, Float32Array]:  # [N], [N], [N, 3]
    """Return how many photos show each point, how many outside a mask, and its mean colour."""
    times, outside = np.zeros((2, len(points)), np.int64)
    total = np.zeros((len(points), 3), np.float32)
    for view in views:
        camera = view.camera
        pose = camera.camera_from_world[0].double().numpy()
        local = points @ pose[:3, :3].T + pose[:3, 3]
        depth = np.maximum(local[:, 2], 1e-9)
        pixel = local[:, :2] / depth[:, None] * camera.focal_px[0].double().numpy()
        pixel += camera.center_px[0].double().numpy()
        inside = (local[:, 2] > 1e-6) & (pixel >= 0).all(axis=1)
        inside &= (pixel < (camera.width, camera.height)).all(axis=1)
        index = np.flatnonzero(inside)
        column, row = pixel[index].astype(np.int64).T
        shown = view.weight[row, column] > 0
        if view.alpha is not None:
            empty = shown & (view.alpha[row, column] == 0)
            outside[index[empty]] += 1
            shown &= ~empty
        times[index[shown]] += 1
        colors = view.colors[row[shown], column[shown]]
        total[index[shown]] += colors.astype(np.float32) / 255.0
    mean: Float32Array = total / np.maximum(times, 1).astype(np.float32)[:, None]
    return times, outside, mean
