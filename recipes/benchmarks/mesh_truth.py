"""Pictures of a mesh by ray casting: the truth that splats of the mesh are measured against.

Conventions
-----------
* The mesh is moved to its object frame; cameras are ``views.Cameras`` there.
* Every pixel is the mean of ``samples x samples`` rays through it; surfaces are two-sided and
  unlit; where the texture's alpha is below 1/2 the ray goes on (at most ``MAX_LAYERS`` times).
* Colours are sRGB and averaged as such, as splats are composited.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from gscomplete.util.arrays import Float32Array
from gscomplete.util.optional import import_open3d
from gscomplete.views import Cameras, ObjectFrame
from splatcomplete_data.mesh.files.load import Mesh

MAX_LAYERS = 6
"""Cut-out surfaces a ray passes before it counts as missing everything."""
_STEP = 1e-4
"""How far behind a cut-out surface the ray goes on, object sizes."""


@dataclass(frozen=True, slots=True)
class Truth:
    """What the mesh looks like from V cameras."""

    color: Float32Array  # [V, H, W, 3] times coverage
    coverage: Float32Array  # [V, H, W] share of rays that hit


def cast_mesh(mesh: Mesh, frame: ObjectFrame, cameras: Cameras, samples: int) -> Truth:
    """Ray cast a mesh.

    Raises:
        UserError: Open3D is not installed.
    """
    core = import_open3d("ray casting").core
    scene = scene_of(mesh, frame)
    colors, covers = [], []
    for view in range(len(cameras)):
        origin, directions = _rays(cameras[view], samples)
        rgb, hit = _cast(mesh, scene, core, origin, directions)
        shape = (cameras.height, samples, cameras.width, samples)
        colors.append(rgb.reshape(*shape, 3).mean(axis=(1, 3), dtype=np.float32))
        covers.append(hit.reshape(shape).mean(axis=(1, 3), dtype=np.float32))
    return Truth(np.stack(colors), np.stack(covers))


def scene_of(mesh: Mesh, frame: ObjectFrame) -> Any:
    """Return the mesh in its object frame as a scene that rays are cast into.

    Raises:
        UserError: Open3D is not installed.
    """
    core = import_open3d("ray casting").core
    from open3d.t.geometry import RaycastingScene

    vertices = np.concatenate([part.vertices for part in mesh.parts]).reshape(-1, 3)
    moved = frame.object_from_file.apply(torch.from_numpy(vertices.astype(np.float64)))
    scene = RaycastingScene()
    faces = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
    scene.add_triangles(core.Tensor(moved.numpy().astype(np.float32)), core.Tensor(faces))
    return scene


def _rays(camera: Cameras, samples: int) -> tuple[Float32Array, Float32Array]:  # [3], [H S W S, 3]
    """Return the camera's centre and its rays, sub-rows and sub-columns interleaved."""
    rotation = camera.camera_from_world[0, :3, :3].double().numpy()
    focal = camera.focal_px[0].double().numpy()
    center = camera.center_px[0].double().numpy()
    x = (np.arange(camera.width * samples) + 0.5) / samples
    y = (np.arange(camera.height * samples) + 0.5) / samples
    grid = np.stack(np.meshgrid((x - center[0]) / focal[0], (y - center[1]) / focal[1]), axis=-1)
    local = np.concatenate([grid, np.ones((*grid.shape[:2], 1))], axis=-1).reshape(-1, 3)
    directions = local @ rotation
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return camera.positions[0].numpy().astype(np.float32), directions.astype(np.float32)


def _cast(
    mesh: Mesh, scene: object, core: object, origin: NDArray, directions: NDArray
) -> tuple[Float32Array, Float32Array]:  # [R, 3], [R]
    """Return colours (0 where nothing is hit) and whether something opaque is hit."""
    rgb = np.zeros((len(directions), 3), np.float32)
    hit = np.zeros(len(directions), np.float32)
    live = np.arange(len(directions))
    start = np.broadcast_to(origin, directions.shape).astype(np.float32)
    firsts = np.cumsum([0] + [len(part.vertices) for part in mesh.parts])
    for _ in range(MAX_LAYERS):
        rays = np.concatenate([start, directions[live]], axis=1)
        answer = scene.cast_rays(core.Tensor(rays))  # type: ignore[attr-defined]
        distance = answer["t_hit"].numpy()
        there = np.isfinite(distance)
        live, distance = live[there], distance[there]
        triangle = answer["primitive_ids"].numpy()[there].astype(np.int64)
        uv = answer["primitive_uvs"].numpy()[there]
        weights = np.stack([1 - uv[:, 0] - uv[:, 1], uv[:, 0], uv[:, 1]], axis=1)
        rgba = np.empty((len(live), 4), np.float32)
        for part, first, last in zip(mesh.parts, firsts, firsts[1:], strict=False):
            mine = (triangle >= first) & (triangle < last)
            rgba[mine] = part.colors_at(triangle[mine] - first, weights[mine])
        opaque = rgba[:, 3] >= 0.5
        rgb[live[opaque]], hit[live[opaque]] = np.clip(rgba[opaque, :3], 0, 1), 1.0
        start = start[there] + (distance + _STEP)[:, None] * directions[live]
        start, live = start[~opaque], live[~opaque]
        if len(live) == 0:
            break
    return rgb, hit
