"""Meshes to flat splats that cover the surface without holes and without bulging past its edges.

Conventions
-----------
* Splats are discs in the tangent plane: scales are (along x, along y, normal) of their cell
  (``cells``), quaternions turn those axes into the file's; opacity is finite and below 1.
* Frame and units are the mesh file's. Colours are those of ``shading``.
* Cut-outs are dropped where alpha is below 1/2; blended surfaces give their alpha to the splats.
* Modes: ``cells`` cuts every triangle into equal cells (the default); ``grid`` is mesh2splat's
  density, one splat per cell of a grid on the triangle's dominant axis plane; ``random`` is the
  baseline, uniform random points with round (spherical) splats;
  ``poisson`` puts round discs on points that keep their distance (MeshLab's Poisson disks).
* Nothing is dropped without a count: ``Conversion.steps`` accounts for every triangle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numba
import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.splats import Splats, colors_to_sh
from gscomplete.util.arrays import Float32Array, Float64Array, IntArray
from splatcomplete_data.mesh.allot import MAX_SPLATS, Allotment, allot_by_count, allot_by_spacing
from splatcomplete_data.mesh.cells import Cells, cut_into_cells, keep_within
from splatcomplete_data.mesh.edges import find_edges, inside_of, marked_edges
from splatcomplete_data.mesh.files.load import BakedLight, Mesh
from splatcomplete_data.mesh.grid import grid_cells
from splatcomplete_data.mesh.sampling import point_frames, poisson_points, uniform_points
from splatcomplete_data.mesh.shading import shade_cells
from splatcomplete_data.mesh.sink import sink, sinking_depth
from splatcomplete_data.objects import StepRecord

ConvertMode = Literal["cells", "grid", "random", "poisson"]
"""How splats are placed; see the module's conventions."""

REACH_SIGMAS = 2.0
"""A splat reaches this many standard deviations, where its opacity is 13 % of that at its
centre."""
MOST_OVERHANG = 0.5
"""Farthest that a splat may reach beyond an edge of its surface, in spacings."""
INSET = 0.3
"""Distance that borders and folds are moved inwards, over the cell's side."""
FAINT = 0.02
"""Blended surface with a smaller alpha is dropped."""
_NORMAL_PER_TANGENT = 0.02
"""Thickness over the smaller tangent standard deviation."""
_FOLD_DEG = 35.0
"""Angle between two triangles from which their edge is a fold."""


OUTLINE_PX = 512.0
"""Pixels that an object's largest side has in a usual picture of its splats."""


@dataclass(frozen=True, slots=True)
class ConvertSettings:
    """Every knob of the conversion."""

    mode: ConvertMode = "cells"
    """How splats are placed."""
    sigma_per_cell: float = 0.5
    """Tangent standard deviation over the cell's side. At 0.5 the thinnest place between four
    splats has an alpha of 0.84; below 0.45 holes show, above 0.6 texture blurs."""
    opacity: float = 0.99
    """Opacity of every splat, in (0, 1)."""
    outline_px: float = 0.0
    """Pixels of the object's largest side in pictures whose outlines are to be right
    (``OUTLINE_PX``). ``cells`` puts splats as far below the surface as 3DGS's blur widens outlines
    in such pictures; 0 = on the surface."""
    seed: int = 0
    """Seed of ``random`` and ``poisson``; the others draw no random numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class Conversion:
    """Splats of a mesh, and how they came about."""

    splats: Splats
    spacing: float
    """Side of a cell, in file units."""
    steps: tuple[StepRecord, ...]


def convert_mesh(
    mesh: Mesh,
    count: int | None = None,
    *,
    spacing: float | None = None,
    settings: ConvertSettings | None = None,
    light: BakedLight | None = None,
) -> Conversion:
    """Cover a mesh with flat splats.

    Args:
        mesh: the surface.
        count: about how many splats; None = by ``spacing``.
        spacing: side of the square of surface that a splat stands for, file units; None = by
            ``count``. Exactly one of the two is given.
        settings: knobs; None = defaults.
        light: shading to multiply into the colours; None = the colours as they are.

    Raises:
        UserError: neither or both of count and spacing, a number out of range, or a mesh that is
            transparent everywhere.
    """
    chosen = settings or ConvertSettings()
    _check(count, spacing, chosen)
    vertices = np.concatenate([part.vertices for part in mesh.parts])
    normals = np.cross(*np.diff(vertices.astype(np.float64), axis=1).swapaxes(0, 1))
    areas = 0.5 * np.linalg.norm(normals, axis=1)
    raised: Float32Array | None = None
    if chosen.mode in ("random", "poisson"):
        number = count or max(1, round(float(areas.sum()) / float(spacing or 1.0) ** 2))
        _check_number(number)
        side = math.sqrt(float(areas.sum()) / number)
        cells, step = _point_cells(vertices, areas, number, side, chosen)
    elif chosen.mode == "grid":
        side = float(spacing or _grid_step(areas, normals, int(count or 1)))
        _check_number(_projected_area(areas, normals) / side**2)
        cells, step = _grid(vertices, normals, side)
    else:
        if spacing is None:
            allotment = allot_by_count(vertices, areas, int(count or 1))
        else:
            allotment = allot_by_spacing(vertices, areas, spacing)
        cells, raised, step = _even_cells(vertices, areas, normals, allotment, chosen)
        side = allotment.spacing
    rgba = shade_cells(mesh.parts, cells)
    opacities = np.full(len(rgba), chosen.opacity, np.float32)
    blended = np.repeat(
        [part.blended for part in mesh.parts], [len(p.vertices) for p in mesh.parts]
    )
    see_through = blended[cells.triangle]
    opacities[see_through] *= rgba[see_through, 3]
    kept = np.where(see_through, rgba[:, 3] >= FAINT, rgba[:, 3] >= 0.5)
    hidden = int(len(kept) - kept.sum())
    steps = (
        *_load_steps(mesh),
        step,
        StepRecord("cut_outs", len(kept), len(kept) - hidden, _reason(hidden)),
    )
    if hidden == len(kept):
        raise UserError("mesh: expected an opaque surface, found transparency everywhere")
    colors = rgba[:, :3]
    if light is not None:
        unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        colors = colors * light.shade(unit[cells.triangle])[:, None]
    splats = _splats(vertices, cells, raised, colors, opacities, chosen)
    if hidden:
        splats = splats.select(torch.from_numpy(kept))
    return Conversion(splats, side, steps)


def _check(count: int | None, spacing: float | None, settings: ConvertSettings) -> None:
    """Check the request."""
    if (count is None) == (spacing is None):
        raise UserError("mesh: expected exactly one of count and spacing")
    if spacing is not None and not 0 < spacing < math.inf:
        raise UserError(f"mesh: spacing: expected a positive length, found {spacing}")
    if count is not None and count < 1:
        raise UserError(f"mesh: count: expected a positive number, found {count}")
    if not 0 < settings.opacity < 1 or settings.sigma_per_cell <= 0:
        raise UserError("mesh: expected an opacity in (0, 1) and a positive sigma_per_cell")
    if not 0 <= settings.outline_px < math.inf:
        raise UserError(
            f"mesh: outline_px: expected a number of pixels or 0, found {settings.outline_px}"
        )


def _load_steps(mesh: Mesh) -> tuple[StepRecord, ...]:
    """Return records of the file's triangles that were left out of the mesh."""
    reasons = {"no_area": mesh.degenerate, "not_finite": mesh.non_finite}
    reasons = {name: count for name, count in reasons.items() if count}
    before = mesh.triangles + mesh.degenerate + mesh.non_finite
    return (StepRecord("triangles_of_the_file", before, mesh.triangles, reasons),)


def _reason(hidden: int) -> dict[str, int]:
    """Name what cut-outs remove."""
    return {"transparent": hidden} if hidden else {}


def _empty(count: int) -> Cells:
    """Make room for cells."""
    return Cells(
        np.empty(count, np.int64),
        np.empty((count, 3), np.float32),
        np.empty((count, 2, 3), np.float32),
        np.empty((count, 2, 3), np.float32),
        np.empty((count, 2), np.float32),
    )


def _even_cells(
    vertices: Float32Array,
    areas: Float64Array,
    normals: Float64Array,
    allotment: Allotment,
    settings: ConvertSettings,
) -> tuple[Cells, Float32Array, StepRecord]:
    """Cut every triangle into its cells; those of tiny triangles get the size they stand for.

    Returns:
        The cells, how far from them along their normals the splats lie, and a record.
    """
    edges = find_edges(vertices)
    marked, ends = marked_edges(edges, normals, _FOLD_DEG)
    inside = inside_of(edges, vertices, normals)
    depth = sinking_depth(vertices, allotment.spacing, settings.outline_px)
    cells = _empty(allotment.total)
    cut_into_cells(
        vertices,
        allotment.counts,
        areas,
        np.where(allotment.tiny_area > 0, np.uint8(0), marked),
        ends,
        INSET,
        allotment.spacing,
        cells.triangle,
        cells.weights,
        cells.steps,
        cells.axes,
        cells.sizes,
    )
    stands_for = allotment.tiny_area[cells.triangle]
    shared = stands_for > 0
    cells.sizes[shared] = np.sqrt(stands_for[shared])[:, None]
    keep_within(
        vertices,
        marked,
        cells.triangle,
        cells.weights,
        cells.axes,
        REACH_SIGMAS * settings.sigma_per_cell,
        MOST_OVERHANG * allotment.spacing,
        cells.sizes,
    )
    raised = sink(vertices, cells, inside, depth, allotment.spacing)
    carrying = int((allotment.counts > 0).sum())
    note = f"spacing {allotment.spacing:.4g}"
    if allotment.tiny:
        note += f"; {allotment.tiny:,} tiny triangles share splats with their neighbours"
    if raised.any():
        note += f"; splats lie up to {depth:.3g} below the surface (--outline-px)"
    step = StepRecord("triangles_with_splats", len(areas), carrying, {}, note)
    if carrying < len(areas):
        shared_out = {"represented_by_a_neighbour": len(areas) - carrying}
        step = StepRecord("triangles_with_splats", len(areas), carrying, shared_out, note)
    return cells, raised, step


def _point_cells(
    vertices: Float32Array,
    areas: Float64Array,
    count: int,
    side: float,
    settings: ConvertSettings,
) -> tuple[Cells, StepRecord]:
    """Random points, each with a square cell of one size."""
    if settings.mode == "random":
        triangle, weights = uniform_points(areas, count, settings.seed)
    else:
        triangle, weights = poisson_points(vertices, areas, count, settings.seed)
    cells = _empty(len(triangle))
    cells.triangle[:], cells.weights[:] = triangle, weights
    cells.axes[:], cells.steps[:] = point_frames(vertices, triangle, side)
    if settings.mode == "random":
        cells.steps[:] = 0  # the baseline takes a single colour sample
    cells.sizes[:] = side
    hit = len(np.unique(triangle))
    missed = {"missed_by_chance": len(areas) - hit} if hit < len(areas) else {}
    return cells, StepRecord("triangles_with_splats", len(areas), hit, missed)


def _grid(vertices: Float32Array, normals: Float64Array, side: float) -> tuple[Cells, StepRecord]:
    """Cells of a grid on each triangle's dominant axis plane, and one for each it misses."""
    triangle, weights, steps, axes, sizes, missed = grid_cells(vertices, normals, side)
    found = {"between_grid_points_got_one_each": missed} if missed else {}
    note = f"grid step {side:.4g}"
    if found:
        note += f"; {missed:,} triangles contain no grid point and have one splat each"
    step = StepRecord("triangles_with_splats", len(vertices), len(vertices), {}, note)
    return Cells(triangle, weights, steps, axes, sizes), step


def _grid_step(areas: Float64Array, normals: Float64Array, count: int) -> float:
    """Grid step for about ``count`` splats: projected area over count."""
    return math.sqrt(_projected_area(areas, normals) / count)


def _projected_area(areas: Float64Array, normals: Float64Array) -> float:
    """Area of all triangles, each projected along its dominant axis."""
    length = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    return float((areas * np.abs(normals).max(axis=1) / length).sum())


def _check_number(number: float) -> None:
    """Refuse a number of splats that would not fit into memory.

    Raises:
        UserError: there are too many splats.
    """
    if number > MAX_SPLATS:
        raise UserError(f"mesh: expected at most {MAX_SPLATS:,} splats, found {round(number):,}")


def _splats(
    vertices: Float32Array,
    cells: Cells,
    raised: Float32Array | None,
    colors: Float32Array,
    opacities: Float32Array,
    settings: ConvertSettings,
) -> Splats:
    """Turn cells into splats."""
    count = len(cells.triangle)
    means = np.empty((count, 3), np.float32)
    quaternions = np.empty((count, 4), np.float32)
    scales = np.empty((count, 3), np.float32)
    raised = np.zeros(count, np.float32) if raised is None else raised
    _place(vertices, cells.triangle, cells.weights, cells.axes, raised, means, quaternions)
    scales[:, :2] = cells.sizes * np.float32(settings.sigma_per_cell)
    flatness = 1.0 if settings.mode == "random" else _NORMAL_PER_TANGENT
    scales[:, 2] = scales[:, :2].min(axis=1) * np.float32(flatness)
    return Splats(
        torch.from_numpy(means),
        torch.from_numpy(quaternions),
        torch.from_numpy(scales),
        torch.from_numpy(opacities),
        colors_to_sh(torch.from_numpy(np.ascontiguousarray(colors, np.float32))),
    )


@numba.njit(cache=True, parallel=True)
def _place(
    vertices: Float32Array,  # [T, 3, 3]
    triangle: IntArray,  # [N]
    weights: Float32Array,  # [N, 3]
    axes: Float32Array,  # [N, 2, 3]
    raised: Float32Array,  # [N] how far the splat lies from its cell, along x cross y
    means: Float32Array,  # [N, 3] out
    quaternions: Float32Array,  # [N, 4] out, wxyz
) -> None:
    """Fill in positions, and the quaternions that turn x, y, z onto the cells' axes."""
    for n in numba.prange(len(triangle)):
        t = triangle[n]
        for axis in range(3):
            total = np.float32(0.0)
            for corner in range(3):
                total += weights[n, corner] * vertices[t, corner, axis]
            means[n, axis] = total
        a, d, g = axes[n, 0, 0], axes[n, 0, 1], axes[n, 0, 2]  # columns of the rotation
        b, e, h = axes[n, 1, 0], axes[n, 1, 1], axes[n, 1, 2]
        c, f, i = d * h - g * e, g * b - a * h, a * e - d * b
        means[n, 0] += raised[n] * c
        means[n, 1] += raised[n] * f
        means[n, 2] += raised[n] * i
        # the largest of the four squares divides: at least 1 of their sum of 4
        if a + e + i > 0.0:
            w, x, y, z = 1.0 + a + e + i, h - f, c - g, d - b
        elif a >= e and a >= i:
            w, x, y, z = h - f, 1.0 + a - e - i, b + d, c + g
        elif e >= i:
            w, x, y, z = c - g, b + d, 1.0 - a + e - i, f + h
        else:
            w, x, y, z = d - b, c + g, f + h, 1.0 - a - e + i
        length = math.sqrt(w * w + x * x + y * y + z * z)
        quaternions[n, 0], quaternions[n, 1] = w / length, x / length
        quaternions[n, 2], quaternions[n, 3] = y / length, z / length
