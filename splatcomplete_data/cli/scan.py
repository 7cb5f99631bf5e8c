"""``splatcomplete-data scan``: an object out of a LiDAR or RGB-D scan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gscomplete.errors import UserError
from gscomplete.util.parse import parse_numbers
from splatcomplete_data.cli.common import (
    ObjectDraft,
    StageCallback,
    check_out,
    framing_request,
    ignore_stage,
    report_object,
    say,
    stages,
    store_object,
)
from splatcomplete_data.cli.points import PointOptions, PointSource, made_from_points


@dataclass(frozen=True, kw_only=True)
class ScanOptions(PointOptions):
    """Cut one object out of a scan and turn it into splats of one size.

    Planes are found in the complete scene. Then boxes, planes, outliers and clutter remove points
    in this order; each step is counted, and removed.png shows the removed points. Unless --up or
    --level says otherwise, up is Z (for a mesh as in `mesh`: Y for GLB and glTF, as the file says
    for DAE; for a depth camera's PCD that of its picture).

    Example: splatcomplete-data scan table.pcd --propose

    Then, with a printed seed point: splatcomplete-data scan table.pcd
    --seed-point=0.1,0.05,0.9 --level --prompt "a cereal box" --out cereal
    """

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """PLY, PCD, LAS/LAZ, text with a point per line (a header may name the columns), or a scanned
    mesh (PLY, OBJ, GLB, ...)."""
    label: int | None = None
    """Keep points with this label // 10 (labelled PCD files); None = all."""
    viewpoint: str | None = None
    """Position of the scanner as X,Y,Z in the file's frame; None = a PCD's VIEWPOINT (for a depth
    camera's PCD the origin), else unknown."""
    propose: bool = False
    """Only draw the objects found in the scan, numbered, into clusters.png in the current folder
    (or --out), and print a seed point and a box for each."""
    pick: Path | None = None
    """Only open a page in which to move, turn and size boxes over the scan, starting with those of
    --box, and save them to this file (.txt), which --box reads."""


def run(options: ScanOptions) -> int:
    """Make the object, or propose clusters; return the exit code."""
    if options.pick is not None:
        return _pick(options, options.pick)
    if options.propose:
        return _propose(options)
    check_out(options, options.file)
    with stages("scan") as enter:
        made = make(options, enter)
        enter("writing the object", 0.7)
        record = store_object(options, made)
    return report_object(options, made, record)


def make(options: ScanOptions, enter: StageCallback = ignore_stage) -> ObjectDraft:
    """Read the scan and make the part.

    Args:
        options: the flags.
        enter: told when a stage begins.

    Raises:
        UserError: the file cannot be read, a flag is wrong, or a step keeps nothing.
    """
    enter("reading", 0.0)
    return made_from_points(options, _read(options), options.file, "lidar", {}, enter)


def _read(options: ScanOptions) -> PointSource:
    """Read the scan, keep a label, and find where the scanner stood.

    Raises:
        UserError: the file cannot be read, it lacks the label, or --viewpoint is no point.
    """
    import numpy as np

    from splatcomplete_data.mesh.files.up_axis import up_of_mesh_file
    from splatcomplete_data.objects import StepRecord
    from splatcomplete_data.scan.read import read_scan

    scan = read_scan(options.file)
    cloud = scan.cloud
    dropped = {"not_finite": scan.rows - len(cloud)} if scan.rows > len(cloud) else {}
    steps = [StepRecord("read", scan.rows, len(cloud), dropped)]
    scene = None
    if options.label is not None:
        if cloud.labels is None:
            raise UserError(f"{options.file}: --label: expected a label field, found none")
        inside = np.flatnonzero(cloud.labels // 10 == options.label)
        if len(inside) == 0:
            found = sorted(set((cloud.labels // 10).tolist()))
            raise UserError(
                f"{options.file}: --label: expected one of {found}, found {options.label}"
            )
        counts = {"other_label": len(cloud) - len(inside)}
        steps.append(StepRecord("label", len(cloud), len(inside), counts))
        scene, cloud = cloud.points, cloud.select(inside)
    given, notes = parse_numbers(options.viewpoint, 3, "--viewpoint", "X,Y,Z"), scan.notes
    eye = scan.viewpoint if given is None else (given[0], given[1], given[2])
    if given is None and eye is not None:
        place = ",".join(f"{value:.15g}" for value in eye)
        why = "VIEWPOINT" if scan.up is None else "picture"
        notes = (*notes, f"the scanner stood at {place}, as the file's {why} says")
    up = up_of_mesh_file(options.file) if scan.up is None else scan.up
    is_known = scan.up is not None  # it is that of the depth picture that the scan is
    return PointSource(cloud, up, is_known, is_known, eye, scene, tuple(steps), notes)


def _propose(options: ScanOptions) -> int:
    """Draw and print what stands in the scan, and write nothing else.

    Raises:
        UserError: as ``make``; or --out holds a finished object, or an option has no effect.
    """
    import json
    import sys

    from gscomplete.evaluate.pictures import require_own_picture, save_image
    from gscomplete.util import jsonio
    from splatcomplete_data.cli.points import part_settings, require_heeded
    from splatcomplete_data.objects import CLUSTERS_FILE, RECORD_FILE
    from splatcomplete_data.scan.clean import CleanSettings, Surroundings
    from splatcomplete_data.scan.propose import cluster_sheet, propose_clusters

    if options.out is not None and (options.out / RECORD_FILE).exists():
        raise UserError(
            f"{options.out}: --propose: expected a folder without a finished object, whose "
            f"{CLUSTERS_FILE} would be replaced"
        )
    path = (options.out or Path()) / CLUSTERS_FILE
    require_own_picture(path)
    settings = part_settings(options)
    planes = 0 if settings.cleaning is None else settings.cleaning.planes
    require_heeded(options, CleanSettings(planes=planes, clusters=0), is_levelled=False)
    with stages("scan") as enter:
        enter("reading", 0.0)
        source = _read(options)
        request = framing_request(options, source.up)
        is_told = source.is_up_known or options.up != "auto"
        from gscomplete.views import axis_direction

        up = axis_direction(request.up) if is_told else None
        around = Surroundings(source.viewpoint, up, source.scene)
        enter(f"looking for objects among {len(source.cloud):,} points", 0.2)
        found = propose_clusters(source.cloud, settings, str(options.file), around)
        enter("drawing", 0.7)
        sheet = cluster_sheet(found, request.up, options.file.name)
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
    save_image(sheet, path)
    say(options, *source.notes, *found.part.warnings)
    for number, cluster in enumerate(found.clusters, 1):
        seed, box = (",".join(f"{v:.4g}" for v in row) for row in (cluster.seed, cluster.box))
        say(options, f"{number}: {cluster.count:,} points; --seed-point={seed} or --box={box}")
    say(options, f"drawn: {path} (axes x red, y green, z blue)")
    if options.json:
        content = {"clusters": jsonio.to_json(found.clusters), "picture": path.as_posix()}
        sys.stdout.write(json.dumps(content) + "\n")
    return 0


def _pick(options: ScanOptions, path: Path) -> int:
    """Let the user choose boxes on a page.

    Raises:
        UserError: as ``make``; or the page cannot be served, or an option has no effect.
    """
    from gscomplete.views import axis_direction
    from splatcomplete_data.cli.pick import check_options, run_page
    from splatcomplete_data.cli.points import part_settings, require_heeded
    from splatcomplete_data.cuts.box_page import PickedPoints
    from splatcomplete_data.scan.clean import CleanSettings

    check_options(path, propose=options.propose)
    require_heeded(options, CleanSettings(planes=0, clusters=0), is_levelled=False)
    source = _read(options)
    cloud = source.cloud
    up = axis_direction(framing_request(options, source.up).up)
    picked = PickedPoints(cloud.points, cloud.colors, up)
    return run_page(picked, part_settings(options).boxes, path, "scan", options.file)
