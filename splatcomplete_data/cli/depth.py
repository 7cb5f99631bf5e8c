"""``splatcomplete-data depth``: one picture with depth to splats of one size."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gscomplete.util import jsonio
from gscomplete.util.parse import parse_numbers
from splatcomplete_data.cli.common import (
    ObjectDraft,
    StageCallback,
    check_out,
    ignore_stage,
    report_object,
    stages,
    store_object,
)
from splatcomplete_data.cli.points import PointOptions, PointSource, made_from_points


@dataclass(frozen=True, kw_only=True)
class DepthOptions(PointOptions):
    """Turn one picture and its depth into a partial object.

    If the picture has a floor or table, even one that is cut away, the object is levelled on it (z
    up). Otherwise, or with --keep-tilt, its frame has the camera's axes (x right, y down, z
    forward), where up is -Y unless --up says otherwise. The input view is the photo's own. An EXIF
    rotation is applied to the pixels if they fit the depth only then; otherwise it only tells which
    way is up. Flying pixels at depth edges are removed. Depth Anything 3's results.npz is read
    directly, with "-" as IMAGE.

    Example: splatcomplete-data depth photo.jpg depth.png --fov 60 --mask mask.png --out mug
    """

    image: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="IMAGE")]
    """Picture; "-" = the one inside the depth file."""
    depth: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DEPTH")]
    """Depth image: NPY, NPZ, 16-bit PNG or PGM, TIFF or EXR."""
    kind: Literal["metric", "disparity", "inverse"] = "metric"
    """Depth of a pixel by its value. metric: value x unit; disparity: focal x baseline / (value x
    unit + offset); inverse: unit / value."""
    unit: float | None = None
    """Length of one depth unit (0.001 for millimetres), or pixels per unit of disparity (KITTI:
    0.00390625); None = 1, or 0.001 for integers other than disparities."""
    baseline: float | None = None
    """Distance between the two cameras of a disparity image."""
    disparity_offset: float = 0.0
    """Added to disparities (difference of the principal points)."""
    intrinsics: Path | None = None
    """Intrinsics file: JSON (Open3D, RealSense, Record3D, ROS, or fx, fy, cx, cy), four numbers
    (fx fy cx cy), or a 3 x 3 matrix. Pixel centres are at +0.5; in files of Open3D, RealSense and
    ROS at 0."""
    focal: str | None = None
    """Focal length F or FX,FY, or with the principal point FX,FY,CX,CY, in pixels of the
    picture."""
    center_px: str | None = None
    """Principal point CX,CY in pixels, with --focal F or FX,FY or --fov; None = the middle."""
    fov: float | None = None
    """Horizontal field of view in degrees."""
    mask: Path | None = None
    """Picture that is white where the object is; None = the alpha of an RGBA picture, if any."""
    crop_px: str | None = None
    """Keep the rectangle X0,Y0,X1,Y1 of the depth image."""
    near: float | None = None
    """Drop pixels nearer than this depth."""
    far: float | None = None
    """Drop pixels farther than this depth."""
    min_confidence: float | None = None
    """Drop pixels of smaller confidence."""
    flying: float = 0.02
    """Relative depth jump from which a pixel between two surfaces counts as flying; 0 = keep
    all."""
    sigma: float = 0.5
    """Standard deviation of splats over the point spacing; larger values close holes in surfaces
    seen obliquely, but blur."""
    frame: int = 0
    """Index of the picture, for an NPZ that holds several."""


def run(options: DepthOptions) -> int:
    """Make the object; return the exit code."""
    check_out(options, source_of(options))
    with stages("depth") as enter:
        made = make(options, enter)
        enter("writing the object", 0.7)
        record = store_object(options, made)
    return report_object(options, made, record)


def source_of(options: DepthOptions) -> Path:
    """Return the file that the record names as source."""
    return options.depth if str(options.image) == "-" else options.image


def make(options: DepthOptions, enter: StageCallback = ignore_stage) -> ObjectDraft:
    """Read picture and depth and make the part.

    Args:
        options: the flags.
        enter: told when a stage begins.

    Raises:
        UserError: a file cannot be read, a flag is wrong, or a step keeps nothing.
    """
    from splatcomplete_data.singleview.load import SingleViewSettings, load_single_view

    given = len((options.focal or "").split(","))
    focal = parse_numbers(options.focal, given, "--focal", "F, FX,FY or FX,FY,CX,CY")
    center = parse_numbers(options.center_px, 2, "--center-px", "CX,CY")
    crop = parse_numbers(options.crop_px, 4, "--crop-px", "X0,Y0,X1,Y1")
    settings = SingleViewSettings(
        kind=options.kind,
        unit=options.unit,
        baseline=options.baseline,
        disparity_offset=options.disparity_offset,
        intrinsics=options.intrinsics,
        focal_px=None if focal is None else tuple(focal),
        center_px=None if center is None else (center[0], center[1]),
        fov_deg=options.fov,
        mask=options.mask,
        crop_px=None if crop is None else (int(crop[0]), int(crop[1]), int(crop[2]), int(crop[3])),
        near=options.near,
        far=options.far,
        min_confidence=options.min_confidence,
        flying_jump=options.flying,
        frame=options.frame,
    )
    image = None if str(options.image) == "-" else options.image
    enter("reading", 0.0)
    view = load_single_view(image, options.depth, settings)
    found = PointSource(
        view.cloud,
        view.up,
        is_up_known=True,
        is_picture_up=True,
        viewpoint=(0.0, 0.0, 0.0),
        scene=view.scene,
        steps=view.steps,
        notes=view.notes,
    )
    details = {"camera": jsonio.to_json(view.camera), "depth": options.depth.as_posix()}
    return made_from_points(options, found, source_of(options), "singleview", details, enter)
