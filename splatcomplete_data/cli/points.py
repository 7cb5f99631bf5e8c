"""Flags and steps that ``scan`` and ``depth`` share: both turn points into fixed-size splats."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from gscomplete.errors import UserError
from gscomplete.util.parse import parse_numbers
from splatcomplete_data.cli.common import ObjectDraft, ObjectOptions, StageCallback, ignore_stage

if TYPE_CHECKING:
    from gscomplete.util.arrays import Float64Array
    from gscomplete.views import UpAxis
    from splatcomplete_data.objects import StepRecord, Subset
    from splatcomplete_data.scan.clean import CleanSettings
    from splatcomplete_data.scan.cloud import PointCloud
    from splatcomplete_data.scan.make import PartSettings


@dataclass(frozen=True, kw_only=True)
class PointOptions(ObjectOptions):
    """Flags of commands that turn points into splats."""

    box: tuple[str, ...] = ()
    """Boxes in the source's frame, several allowed: [keep:|remove:]CX,CY,CZ,HX,HY,HZ[,QW,QX,QY,QZ]
    (centre, half extents, rotation), or a file of boxes that `scan --pick` or `crop --pick`
    saved."""
    planes: int | None = None
    """Remove up to this many planes: floor, walls, table. They are searched in the complete scene,
    level ones first; faces of the object do not count. None = 1 with --level, --seed-point or
    (`scan`) --propose, else 0."""
    plane_thickness: float = 4.0
    """Points this close to a plane belong to it, in point spacings; the distance is reduced where
    the plane has less noise."""
    outliers: bool = True
    """Remove statistical outliers."""
    clusters: int = 0
    """Keep this many of the largest connected clusters; 0 = all."""
    cluster_radius: float = 5.0
    """Points closer than this belong to one cluster, in point spacings."""
    seed_point: str | None = None
    """Keep the object at X,Y,Z (source's frame) instead of the largest cluster; it is separated
    from objects that touch it where the surface folds inwards or changes colour."""
    level: bool = False
    """Turn the object so that the first plane found is level and z is up, or fail; recorded. Up is
    the side of the plane where the scanner stood or, if that is unknown, where most kept points
    are. Pictures with depth are levelled without this option if the scene has a floor or table and
    --up is not given."""
    keep_tilt: bool = False
    """Never turn the object: up is that of the picture even if its camera looked down."""
    count: int | None = None
    """Thin to at most this many evenly spread points; None = keep all."""
    spacing: float | None = None
    """Thin to one point per cube of this side; None = keep all."""
    splat_size: str = "auto"
    """Standard deviation of the splats in the source's units; auto = --sigma point spacings."""
    sigma: float = 0.6
    """Standard deviation over the point spacing; below 0.5, surfaces seen obliquely have holes."""


def part_settings(options: PointOptions) -> PartSettings:
    """Parse the flags.

    Raises:
        UserError: one has the wrong form.
    """
    from splatcomplete_data.cuts.boxes import read_boxes
    from splatcomplete_data.scan.clean import CleanSettings
    from splatcomplete_data.scan.make import PartSettings
    from splatcomplete_data.scan.support import PlaneSettings

    seed = parse_numbers(options.seed_point, 3, "--seed-point", "X,Y,Z")
    if options.level and options.up not in ("auto", "Z"):
        raise UserError(f"--level, --up: levelled points have z up, found --up {options.up}")
    if options.level and options.keep_tilt:
        raise UserError("--level, --keep-tilt: expected at most one of them, found both")
    size = (
        None
        if options.splat_size == "auto"
        else parse_numbers(options.splat_size, 1, "--splat-size", "SIGMA")
    )
    for name, radius in (
        ("plane-thickness", options.plane_thickness),
        ("cluster-radius", options.cluster_radius),
    ):
        if not 0 < radius < math.inf:
            raise UserError(f"--{name}: expected a positive number, found {radius:g}")
    if not 0 < options.sigma < 100:
        raise UserError(f"--sigma: expected a positive number, found {options.sigma:g}")
    for name, value in (("planes", options.planes or 0), ("clusters", options.clusters)):
        if value < 0:
            raise UserError(f"--{name}: expected 0 or more, found {value}")
    is_one_implied = options.level or seed is not None or getattr(options, "propose", False)
    planes = int(is_one_implied) if options.planes is None else options.planes
    cleaning = CleanSettings(
        planes=max(planes, int(options.level)),
        plane=PlaneSettings(thickness=options.plane_thickness),
        outlier_ratio=CleanSettings().outlier_ratio if options.outliers else None,
        clusters=options.clusters,
        cluster_radius=options.cluster_radius,
        seed_point=None if seed is None else (seed[0], seed[1], seed[2]),
    )
    return PartSettings(
        boxes=tuple(box for text in options.box for box in read_boxes(text)),
        cleaning=cleaning,
        level="always" if options.level else "never" if options.keep_tilt else "auto",
        count=options.count,
        spacing=options.spacing,
        sigma=None if size is None else size[0],
        sigma_per_spacing=options.sigma,
    )


def require_heeded(options: PointOptions, cleaning: CleanSettings, *, is_levelled: bool) -> None:
    """Refuse options of planes and clusters where none is looked for.

    Args:
        options: the flags.
        cleaning: what is done to the points.
        is_levelled: whether a plane is looked for to level them on.

    Raises:
        UserError: there is one.
    """
    defaults = {field.name: field.default for field in dataclasses.fields(PointOptions)}
    is_clustered = cleaning.clusters > 0 and cleaning.seed_point is None
    for name, is_heeded, where in (
        ("plane_thickness", cleaning.planes > 0 or is_levelled, "planes (--planes N, --level)"),
        ("cluster_radius", is_clustered, "clusters (--clusters N without --seed-point)"),
    ):
        value = getattr(options, name)
        if value != defaults[name] and not is_heeded:
            flag = name.replace("_", "-")
            raise UserError(
                f"--{flag} {value:g}: has no effect where nothing looks for {where}; leave it out"
            )


@dataclass(frozen=True, slots=True)
class PointSource:
    """Points in the frame of the file that they come from, and what is known of them."""

    cloud: PointCloud
    up: UpAxis
    """Up axis of the source's frame; Z after levelling."""
    is_up_known: bool
    """Whether ``up`` is what the source says, not only assumed."""
    is_picture_up: bool
    """Whether ``up`` is a picture's: its camera may look down."""
    viewpoint: tuple[float, float, float] | None
    """Where the scanner stood; None = unknown."""
    scene: Float64Array | None  # [M, 3]
    """All that was scanned, where ``cloud`` is a choice of it; None = it is all."""
    steps: tuple[StepRecord, ...]
    """What was done before."""
    notes: tuple[str, ...]
    """What was noticed before."""


def made_from_points(
    options: PointOptions,
    found: PointSource,
    source: Path,
    subset: Subset,
    details: dict[str, object],
    enter: StageCallback = ignore_stage,
) -> ObjectDraft:
    """Run the shared steps on points in the source's frame.

    Args:
        options: the flags.
        found: the points.
        source: the source file.
        subset: its kind.
        details: what only this kind of source has.
        enter: told when a stage begins.

    Raises:
        UserError: a flag is wrong or has no effect, or a step keeps nothing.
    """
    import torch

    from gscomplete.framing.decide import view_from_position
    from gscomplete.views import ObjectFrame, axis_direction
    from splatcomplete_data.cli.common import framing_request
    from splatcomplete_data.points import offset_note
    from splatcomplete_data.scan.clean import Surroundings
    from splatcomplete_data.scan.make import make_part
    from splatcomplete_data.scan.picture import removed_sheet

    settings = part_settings(options)
    is_picture_up = found.is_picture_up and options.up == "auto"
    assert settings.cleaning is not None
    require_heeded(
        options,
        settings.cleaning,
        is_levelled=settings.level == "always" or (settings.level == "auto" and is_picture_up),
    )
    enter(f"cleaning {len(found.cloud):,} points", 0.2)
    source_up = framing_request(options, found.up).up
    is_up_told = found.is_up_known or options.up != "auto"
    around = Surroundings(
        found.viewpoint,
        axis_direction(source_up) if is_up_told else None,
        found.scene,
        is_picture_up,
    )
    part = make_part(found.cloud, settings, str(source), around)
    moved = part.file_from_source
    up: UpAxis = source_up if part.turn is None else "Z"
    eye = found.viewpoint
    if eye is not None and moved is not None:
        x, y, z = moved.apply(torch.tensor(eye, dtype=torch.float64)).tolist()
        eye = (x, y, z)
    view = (30.0, 25.0)
    if eye is not None:
        view = view_from_position(ObjectFrame.about(part.splats, up), eye)
    pictures = {}
    if (part.reason >= 0).any():
        enter("drawing what was removed", 0.6)
        pictures["removed.png"] = removed_sheet(part, up, view, f"{source.name}: what was removed")
    far = () if part.offset is None else (offset_note(part.offset),)
    size = f"splat size {part.sigma:.4g} source units ({options.splat_size})"
    return ObjectDraft(
        subset,
        source,
        part.splats,
        None,
        up,
        (*found.steps, *part.steps),
        (*found.notes, *part.warnings, *far, size),
        boxes=settings.boxes,
        splat_size=part.sigma,
        camera_position_file=eye,
        file_from_source=moved,
        is_center_of_source=True,
        details=details,
        extra_pictures=pictures,
    )
