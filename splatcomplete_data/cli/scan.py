"""``splatcomplete-data scan``: an object out of a LiDAR or RGB-D scan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gscomplete.cli.parse import parse_numbers
from gscomplete.errors import UserError
from splatcomplete_data.cli.common import (
    Enter,
    Made,
    check_out,
    report_object,
    stages,
    stay_silent,
    store_object,
)
from splatcomplete_data.cli.points import PointOptions, made_from_points


@dataclass(frozen=True, kw_only=True)
class ScanOptions(PointOptions):
    """Cut one object out of a scan and turn it into splats of one size.

    Boxes, planes, outliers and clutter are removed in this order, each with a count; removed.png
    shows the removed points in colours of their own. Up is Z (of meshes as in `mesh`: Y for GLB and
    glTF, what a DAE says) unless --up or --level says otherwise.

    Example: splatcomplete-data scan room.ply --box 1.2,0.4,0.3,0.5,0.5,0.6 --planes 1 --clusters 1
    """

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """PLY, PCD, LAS/LAZ, rows of text (a header names their columns), or a scan mesh (PLY, OBJ,
    GLB, ...)."""
    label: int | None = None
    """Keep points with this label // 10 (labelled PCD files); None = all."""
    viewpoint: str | None = None
    """Where the scanner stood, as X,Y,Z in the file's frame; None = what a PCD's VIEWPOINT says,
    else unknown."""


def run(options: ScanOptions) -> int:
    """Make the object; return the exit code."""
    check_out(options, options.file)
    with stages("scan") as enter:
        made = make(options, enter)
        enter("writing the object", 0.7)
        record = store_object(options, made)
    return report_object(options, made, record)


def make(options: ScanOptions, enter: Enter = stay_silent) -> Made:
    """Read the scan and make the part.

    Args:
        options: the flags.
        enter: told when a stage begins.

    Raises:
        UserError: the file cannot be read, a flag is wrong, or a step keeps nothing.
    """
    import numpy as np

    from splatcomplete_data.mesh.files.up_axis import up_of_mesh_file
    from splatcomplete_data.objects import StepRecord
    from splatcomplete_data.scan.read import read_scan

    enter("reading", 0.0)
    scan = read_scan(options.file)
    cloud = scan.cloud
    dropped = {"not_finite": scan.rows - len(cloud)} if scan.rows > len(cloud) else {}
    steps = [StepRecord("read", scan.rows, len(cloud), dropped)]
    if options.label is not None:
        if cloud.labels is None:
            raise UserError(f"{options.file}: --label: expected a label field, found none")
        inside = np.flatnonzero(cloud.labels // 10 == options.label)
        if len(inside) == 0:
            found = sorted(set((cloud.labels // 10).tolist()))
            raise UserError(f"{options.file}: --label: expected one of {found}")
        counts = {"other_label": len(cloud) - len(inside)}
        steps.append(StepRecord("label", len(cloud), len(inside), counts))
        cloud = cloud.select(inside)
    eye, notes = parse_numbers(options.viewpoint, 3, "--viewpoint", "X,Y,Z"), scan.notes
    if eye is None and scan.viewpoint is not None:
        eye = list(scan.viewpoint)
        place = ",".join(f"{value:.15g}" for value in eye)
        notes = (*notes, f"the scanner stood at {place}, as the file's VIEWPOINT says")
    return made_from_points(
        options,
        cloud,
        options.file,
        "lidar",
        up_of_mesh_file(options.file),
        viewpoint=None if eye is None else (eye[0], eye[1], eye[2]),
        steps=tuple(steps),
        notes=notes,
        details={},
        enter=enter,
    )
