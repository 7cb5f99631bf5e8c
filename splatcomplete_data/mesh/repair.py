"""Repair a loaded mesh with MeshLab: duplicate vertices, null and duplicate faces, orientation.

Conventions
-----------
* Corners keep their colours, texture coordinates and parts; where two faces coincide one stays.
* Every step has a count in ``StepRecord``s, also when it is 0.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from gscomplete.errors import UserError
from gscomplete.util.arrays import BoolArray, IntArray
from splatcomplete_data.mesh.files.load import Mesh
from splatcomplete_data.mesh.files.parts import MeshPart
from splatcomplete_data.mesh.meshlab import repair_triangles
from splatcomplete_data.objects import StepRecord


def repair_mesh(mesh: Mesh) -> tuple[Mesh, tuple[StepRecord, ...]]:
    """Repair a mesh; return it and what was done.

    Raises:
        UserError: pymeshlab is missing or failed, or no face is left.
    """
    found = repair_triangles(np.concatenate([part.vertices for part in mesh.parts]))
    if len(found.kept) == 0:
        raise UserError("mesh: --repair: expected usable faces, found none")
    parts, first = [], 0
    for part in mesh.parts:
        last = first + len(part.vertices)
        inside = (found.kept >= first) & (found.kept < last)
        if inside.any():
            parts.append(_rebuilt(part, found.kept[inside] - first, found.turned[inside]))
        first = last
    before, kept = mesh.triangles, len(found.kept)
    merged = found.vertices_before - found.vertices_after
    turned = int(found.turned.sum())
    note = f"{turned:,} flipped" if found.oriented else "not oriented, as it is not a manifold"
    steps = (
        _step("merge_vertices", found.vertices_before, merged, "same_place"),
        _step("drop_null_faces", before, found.null, "no_area"),
        _step("drop_duplicate_faces", before - found.null, found.duplicate, "duplicate"),
        StepRecord("orient_faces", kept, kept, {}, note),
    )
    return dataclasses.replace(mesh, parts=tuple(parts)), steps


def _step(name: str, before: int, removed: int, reason: str) -> StepRecord:
    """Record a step; a count of 0 is shown as a note, since nothing was removed."""
    reasons = {reason: removed} if removed else {}
    return StepRecord(name, before, before - removed, reasons, "" if removed else "0 found")


def _rebuilt(
    part: MeshPart,
    kept: IntArray,  # [K]
    turned: BoolArray,  # [K]
) -> MeshPart:
    """Pick triangles and swap corners 1 and 2 of those that face the wrong way."""
    order = np.where(turned[:, None], [0, 2, 1], [0, 1, 2])
    rows = kept[:, None]
    return dataclasses.replace(
        part,
        vertices=part.vertices[rows, order],
        colors=part.colors[rows, order],
        uv=None if part.uv is None else part.uv[rows, order],
    )
