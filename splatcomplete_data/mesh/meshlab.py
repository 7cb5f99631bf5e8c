"""Calls of MeshLab (pymeshlab): thin points to a Poisson-disk set, and repair triangles.

Conventions
-----------
* Every call runs in a process of its own. MeshLab's random numbers continue from call to call and
  cannot be seeded, so only in a fresh process are they a function of the input; and if a damaged
  mesh crashes MeshLab, the caller survives.
* Points and triangles carry their index as MeshLab's scalar, so results are indices into the
  caller's arrays, and colours are never handed to MeshLab.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, TypeVar

import numpy as np

from gscomplete.errors import UserError
from gscomplete.util.arrays import BoolArray, Float32Array, Float64Array, IntArray
from gscomplete.util.optional import import_optional

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True, eq=False)
class Repair:
    """What MeshLab's repair says about T triangles."""

    kept: IntArray  # [K] indices of the triangles that stay, ascending
    turned: BoolArray  # [K] whose corners 1 and 2 change places
    vertices_before: int
    vertices_after: int
    null: int
    """Triangles with two corners in one place, or without area."""
    duplicate: int
    """Triangles on the same three vertices as another."""
    oriented: bool
    """False = an edge has more than two triangles, so there are no two sides to agree on."""


def prune_to_poisson_disk(
    points: Float64Array,  # [N, 3]
    radius: float,
) -> IntArray:  # [M]
    """Choose points of which no two are closer than ``radius``, and that leave no room for more.

    Raises:
        UserError: pymeshlab is missing or failed.
    """
    return _in_own_process(_prune, points, radius)


def repair_triangles(vertices: Float32Array) -> Repair:  # [T, 3, 3]
    """Merge equal vertices, find null and duplicate triangles, and orient the rest coherently.

    Raises:
        UserError: pymeshlab is missing or failed.
    """
    return _in_own_process(_repair, vertices)


def _in_own_process(function: Callable[..., Result], *arguments: Any) -> Result:
    """Call a function of this module in a fresh process."""
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            return pool.submit(function, *arguments).result()
    except BrokenProcessPool as error:
        raise UserError(
            "mesh: MeshLab crashed on this mesh; leave out --repair and --mode poisson"
        ) from error


def _prune(points: Float64Array, radius: float) -> IntArray:
    meshlab = import_optional("pymeshlab", "Poisson-disk sampling")
    meshes = meshlab.MeshSet()
    numbers = np.arange(len(points), dtype=np.float64)
    meshes.add_mesh(meshlab.Mesh(vertex_matrix=points, v_scalar_array=numbers))
    _apply(
        meshlab,
        meshes,
        "generate_sampling_poisson_disk",
        radius=meshlab.PureValue(radius),
        subsample=True,
    )
    chosen: IntArray = np.rint(meshes.current_mesh().vertex_scalar_array()).astype(np.int64)
    return np.sort(chosen)


def _repair(vertices: Float32Array) -> Repair:
    meshlab = import_optional("pymeshlab", "mesh repair")
    count = len(vertices)
    corners = vertices.reshape(-1, 3).astype(np.float64)
    faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    numbers = np.arange(count, dtype=np.float64)
    meshes = meshlab.MeshSet()
    meshes.add_mesh(meshlab.Mesh(corners, faces, f_scalar_array=numbers))
    _apply(meshlab, meshes, "meshing_remove_duplicate_vertices")
    merged = meshes.current_mesh().vertex_number()
    _apply(meshlab, meshes, "meshing_remove_null_faces")
    not_null = meshes.current_mesh().face_number()
    _apply(meshlab, meshes, "meshing_remove_duplicate_faces")
    single = meshes.current_mesh().face_number()
    oriented = True
    try:
        meshes.apply_filter("meshing_re_orient_faces_coherently")
    except meshlab.PyMeshLabException:
        oriented = False
    mesh = meshes.current_mesh()
    kept = np.rint(mesh.face_scalar_array()).astype(np.int64)
    found = mesh.vertex_matrix()[mesh.face_matrix()] if len(kept) else np.empty((0, 3, 3))
    cosine = np.einsum("tc,tc->t", _normals(vertices[kept].astype(np.float64)), _normals(found))
    order = np.argsort(kept)
    null, duplicate = count - not_null, not_null - single
    turned = cosine[order] < 0
    return Repair(kept[order], turned, 3 * count, merged, null, duplicate, oriented)


def _apply(meshlab: Any, meshes: Any, name: str, **arguments: Any) -> None:
    """Run one of MeshLab's filters.

    Raises:
        UserError: it refuses.
    """
    try:
        meshes.apply_filter(name, **arguments)
    except meshlab.PyMeshLabException as error:
        raise UserError(f"mesh: MeshLab's {name} failed ({str(error).strip()})") from error


def _normals(vertices: Float64Array) -> Float64Array:  # [T, 3, 3] -> [T, 3]
    """Cross products of the edges."""
    return np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
