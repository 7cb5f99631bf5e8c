"""Baselines that need no other system: P, mirror images of it, retrieval, a closed surface.

Conventions
-----------
* All start from what a completion has: up axis, c and V of the object folder, centre and size
  guessed from P unless the user gave them. The result is in P's file frame and contains P's splats,
  except for retrieval.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree

from gscomplete.completion.pipeline import framing_for
from gscomplete.errors import UserError
from gscomplete.evaluate.align.refine import Candidate, Target, surface_of
from gscomplete.folders import ObjectFolder
from gscomplete.framing.decide import FramingRequest
from gscomplete.priors import Prior
from gscomplete.shape.fill.facing import look_around, outward_normals
from gscomplete.splats import Splats, colors_to_sh, concatenate, read_splats, usable_rows
from gscomplete.splats.transform import Similarity, transform_splats
from gscomplete.util.optional import import_open3d
from recipes.baselines.bank import Bank, nearest
from recipes.real_objects.compare import FramedObject, best_by_truth, mirror_images
from recipes.real_objects.load import RealObject
from splatcomplete_data.mesh.discs import (
    ColoredTriangles,
    discs_at,
    triangles_to_discs,
)

_POISSON_DEPTH = 7
"""Of the octree: cells of 1/128 of a cube about P."""
_SURE = 0.2
"""Normals less sure than this are left out."""
_COVERED = 2.0
"""Surface nearer to P than so many spacings, of nine tenths of P's splats, is P's own."""
_CLOSING_SPLATS = 30_000


class NotApplicable(UserError):
    """A baseline needs something that this object lacks: it is left out, which is no failure."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """P as a baseline gets it."""

    framed: FramedObject
    object_from_file: Similarity
    bank: Bank | None
    """Objects to retrieve from; None = there are none."""

    @property
    def partial(self) -> Splats:
        """P in the object frame, in base colours."""
        return self.framed.partial.with_sh_degree(0)


def read_part(known: ObjectFolder, prior: Prior, bank: Bank | None) -> Part:
    """Read P and decide its frame as a completion does.

    Args:
        known: the object folder.
        prior: whose shape network settles what P leaves open, as in a completion.
        bank: objects to retrieve from, for ``nearest_mesh``.

    Raises:
        UserError: a file cannot be read, or P not drawn.
    """
    partial = _drawable(known.partial)
    truth = None if known.complete is None else _drawable(known.complete)
    views = known.views
    request = FramingRequest(
        known.frame.up,
        (views.azimuth_deg, views.elevation_deg),
        views.azimuth_range_deg,
        known.known_center,
        known.known_size,
        elevation_range_deg=views.elevation_range_deg,
    )
    framing = framing_for(partial, request, prior)
    to_object = framing.frame.object_from_file
    item = RealObject(known.id, known.prompt, known.frame.up, partial, truth, "")
    framed = FramedObject(
        item,
        transform_splats(partial, to_object),
        None if truth is None else transform_splats(truth, to_object),
        framing.views,
    )
    return Part(framed, to_object, bank)


def completed_here(method: str, part: Part) -> Splats:  # in P's file frame
    """Complete a part by a baseline of ``METHODS``.

    Raises:
        NotApplicable: the method needs a truth that is not known.
        UserError: it needs a bank or a package that is not there.
    """
    return transform_splats(METHODS[method](part), part.object_from_file.inverse())


def likeliest_mirror(part: Part) -> Splats:
    """Add P's mirror image through the plane that is proposed first."""
    return concatenate([part.partial, mirror_images(part.framed)[0].with_sh_degree(0)])


def best_mirror(part: Part) -> Splats:
    """Add the best of three mirror images, chosen with the truth.

    Raises:
        NotApplicable: the truth is not known.
    """
    best = best_by_truth(mirror_images(part.framed), part.framed)
    if best is None:
        raise NotApplicable("it chooses with the complete object, which is not known")
    return concatenate([part.partial, best.with_sh_degree(0)])


def nearest_mesh(part: Part) -> Splats:
    """Return the nearest object of the bank, moved to P.

    Raises:
        UserError: there is no bank.
    """
    if part.bank is None:
        raise UserError("nearest_mesh: --bank: expected the file of a bank, found none")
    splats = part.partial
    rows = np.random.default_rng(0).permutation(len(splats))
    points, colors = splats.means.numpy()[rows], splats.base_colors.numpy()[rows]
    found = nearest(part.bank, points, colors)
    surface = surface_of(found.points.astype(np.float64), found.colors.astype(np.float64))
    few = surface_of(points[:4000].astype(np.float64), colors[:4000].astype(np.float64))
    begin = Candidate(1.0, np.eye(3), np.zeros(3))
    settled = Target.of(surface).refine(begin, few.subset(np.arange(min(1000, len(rows)))), 20)
    placed = settled.undo(surface.points).astype(np.float32)
    spacing = float(np.median(cKDTree(placed).query(placed, k=2)[0][:, 1]))
    normals = (surface.normals @ settled.rotation).astype(np.float32)
    return discs_at(placed, normals, found.colors, spacing)


def poisson_closing(part: Part) -> Splats:
    """Add what screened Poisson reconstruction closes P's surface with, in P's nearest colours.

    Raises:
        UserError: Open3D is not installed, or P has no side that is surely the outer one.
    """
    open3d = import_open3d("the Poisson baseline")
    splats = part.partial
    normals = outward_normals(splats, look_around(splats)).double().numpy()
    length = np.linalg.norm(normals, axis=1)
    sure = length > _SURE
    points = splats.means.double().numpy()
    if sure.sum() < 10:
        raise UserError(
            f"{part.framed.item.name}: expected surfaces with an outer side, found none"
        )
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points[sure]))
    cloud.normals = open3d.utility.Vector3dVector(normals[sure] / length[sure, None])
    mesh, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        cloud, depth=_POISSON_DEPTH, n_threads=1
    )
    corners = np.asarray(mesh.vertices, np.float32)[np.asarray(mesh.triangles)]
    tree = cKDTree(points)
    plain = np.zeros_like(corners)
    closed = triangles_to_discs(ColoredTriangles(corners, plain), _CLOSING_SPLATS)
    away, row = tree.query(closed.means.double().numpy())
    spacing = float(np.quantile(tree.query(points, k=2)[0][:, 1], 0.9))
    lacking = torch.from_numpy(away > _COVERED * spacing)
    closed = dataclasses.replace(closed, sh=colors_to_sh(splats.base_colors[torch.from_numpy(row)]))
    return concatenate([splats, closed.select(lacking)])


METHODS: dict[str, Callable[[Part], Splats]] = {
    "partial": lambda part: part.framed.partial,
    "likeliest_mirror": likeliest_mirror,
    "best_mirror": best_mirror,
    "nearest_mesh": nearest_mesh,
    "poisson": poisson_closing,
}


def _drawable(path: Path) -> Splats:
    splats = read_splats(path).splats
    return splats.select(usable_rows(splats)[0])
