"""One picture with depth to a coloured point cloud in camera axes.

Conventions
-----------
* Everything happens at the depth's resolution: the picture is resized to it (box filter when it
  shrinks), its intrinsics scale with it, and both must have one aspect ratio. ``orientation`` says
  when a photo is turned by its EXIF; intrinsics are those of the picture as turned.
* Steps in order: known depth, near/far, confidence, mask, flying pixels; each counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from gscomplete.errors import UserError
from gscomplete.splats.thinning import every_nth
from gscomplete.util.arrays import BoolArray, Float32Array, Float64Array
from gscomplete.views import UpAxis
from splatcomplete_data.objects import StepRecord
from splatcomplete_data.pictures import UNREADABLE, eight_bits, read_mask
from splatcomplete_data.scan.cloud import PointCloud
from splatcomplete_data.singleview import intrinsics as lens
from splatcomplete_data.singleview.depth_file import DepthImage, DepthKind, metric_depth, read_depth
from splatcomplete_data.singleview.intrinsics import Intrinsics
from splatcomplete_data.singleview.orientation import fitting_picture
from splatcomplete_data.singleview.unproject import FLYING_JUMP, flying_pixels, unproject

_SCENE_POINTS = 150_000
"""Of the complete picture, to find the floor or table in."""


@dataclass(frozen=True, slots=True)
class SingleViewSettings:
    """How picture and depth are read; None = from the files, or not at all."""

    kind: DepthKind = "metric"
    """What the depth values are."""
    unit: float | None = None
    """Length of one depth unit; None = 0.001 for integers, else 1."""
    baseline: float | None = None
    """Distance of the two cameras of a disparity."""
    disparity_offset: float = 0.0
    """Added to disparities."""
    intrinsics: Path | None = None
    """Intrinsics file."""
    focal_px: tuple[float, ...] | None = None
    """fx, or fx, fy, or fx, fy, cx, cy in pixels of the picture."""
    center_px: tuple[float, float] | None = None
    """Principal point in pixels of the picture; None = the middle."""
    fov_deg: float | None = None
    """Horizontal field of view."""
    mask: Path | None = None
    """Picture that is white where the object is (``pictures``)."""
    crop_px: tuple[int, int, int, int] | None = None
    """Keep columns x0 to x1 and rows y0 to y1 of the depth image."""
    near: float | None = None
    """Drop what is nearer, in the depth's unit after scaling."""
    far: float | None = None
    """Drop what is farther."""
    min_confidence: float | None = None
    """Drop pixels of smaller confidence (Depth Anything 3)."""
    flying_jump: float = FLYING_JUMP
    """Depth jump, over the depth, that makes a pixel fly; 0 = keep all."""
    frame: int = 0
    """Which picture of a file that holds several."""


@dataclass(frozen=True, slots=True, eq=False)
class SingleView:
    """A single view as points."""

    cloud: PointCloud
    camera: Intrinsics
    kept: BoolArray  # [H, W] pixels that became points, row by row
    color: Float32Array  # [H, W, 3] the picture at the depth's resolution
    steps: tuple[StepRecord, ...]
    notes: tuple[str, ...]
    scene: Float64Array  # [M, 3] points of the complete picture, evenly thinned
    up: UpAxis = "-Y"
    """The camera's axis that points up."""


def load_single_view(
    image_path: Path | None, depth_path: Path, settings: SingleViewSettings | None = None
) -> SingleView:
    """Read a picture and its depth.

    Args:
        image_path: the picture; None = the one in the depth file.
        depth_path: the depth file.
        settings: knobs; None = defaults.

    Raises:
        UserError: a file is missing, damaged or of the wrong size, there are no intrinsics, or no
            pixel is left.
    """
    chosen = settings or SingleViewSettings()
    _check_settings(chosen)
    depth = read_depth(depth_path, chosen.frame)
    height, width = depth.values.shape
    opened = _open(image_path, depth, depth_path)
    fitting = fitting_picture(opened, width, height, image_path or depth_path)
    picture = fitting.picture
    notes = [*depth.notes, *fitting.notes, *_resized(picture, width, height)]
    if chosen.intrinsics or chosen.focal_px or chosen.fov_deg or depth.intrinsics is not None:
        notes = [note for note in notes if "no intrinsics" not in note]
    camera = _find_camera(chosen, picture, depth).resized(width, height)
    z, how = metric_depth(
        depth,
        chosen.kind,
        unit=chosen.unit,
        focal_px=camera.focal_x_px,
        baseline=chosen.baseline,
        offset=chosen.disparity_offset,
    )
    notes += [how, camera.summary()]
    resized = eight_bits(picture).convert("RGB").resize((width, height), Image.Resampling.BOX)
    color = np.asarray(resized, np.float32) / np.float32(255.0)
    keep, steps = _select(z, depth, picture, chosen, str(depth_path))
    points = unproject(z, camera, keep)
    cloud = PointCloud(points, color[keep])
    known = np.flatnonzero(np.isfinite(z) & (z > 0))
    thinned = np.zeros(z.shape, np.bool_)
    thinned.flat[every_nth(known, _SCENE_POINTS)] = True
    scene = unproject(z, camera, thinned)
    return SingleView(cloud, camera, keep, color, tuple(steps), tuple(notes), scene, fitting.up)


def _check_settings(settings: SingleViewSettings) -> None:
    """Refuse settings that others would set aside, and ranges that no depth image has.

    Raises:
        UserError: there is one.
    """
    for name, value in (("--focal", settings.focal_px), ("--fov", settings.fov_deg)):
        if value is not None and settings.intrinsics is not None:
            raise UserError(f"{name}, --intrinsics: expected one of them, found both")
    of_disparities = {
        "--baseline": settings.baseline is not None,
        "--disparity-offset": settings.disparity_offset != 0,
    }
    for name, is_given in of_disparities.items():
        if is_given and settings.kind != "disparity":
            raise UserError(f"{name}: expected --kind disparity with it, found {settings.kind}")
    if not 0 <= settings.flying_jump < float("inf"):
        raise UserError(f"--flying: expected 0 or more, found {settings.flying_jump:g}")


def _open(path: Path | None, depth: DepthImage, depth_path: Path) -> Image.Image:
    """Open the picture, or take the depth file's."""
    if path is None:
        if depth.color is None:
            raise UserError(f"{depth_path}: expected a picture in it, or an image file; found none")
        return Image.fromarray(depth.color)
    try:
        picture = Image.open(path)
        picture.load()
    except UNREADABLE as error:
        raise UserError(f"{path}: cannot read it as an image ({error})") from error
    return picture


def _resized(picture: Image.Image, width: int, height: int) -> list[str]:
    """Say when the picture is resized."""
    if picture.size == (width, height):
        return []
    return [f"picture {picture.width} x {picture.height} resized to the depth's {width} x {height}"]


def _find_camera(
    settings: SingleViewSettings, picture: Image.Image, depth: DepthImage
) -> Intrinsics:
    """Find intrinsics in the order of trust.

    Raises:
        UserError: there are none.
    """
    focal = None if settings.focal_px is None else list(settings.focal_px)
    center = None if settings.center_px is None else list(settings.center_px)
    given = lens.from_numbers(focal, center, settings.fov_deg, picture.width, picture.height)
    if given is not None:
        return given
    if settings.intrinsics is not None:
        return lens.read_intrinsics(settings.intrinsics, picture.width, picture.height)
    if depth.intrinsics is not None:
        height, width = depth.values.shape
        return lens.from_matrix(depth.intrinsics, width, height, "the depth file")
    found = lens.from_exif(picture)
    if found is not None:
        return found
    raise UserError(
        "intrinsics: expected --focal FX,FY, --intrinsics FILE, --fov DEGREES, or a photo with "
        "EXIF; found none of them"
    )


def _select(
    z: Float64Array,
    depth: DepthImage,
    picture: Image.Image,
    settings: SingleViewSettings,
    source: str,
) -> tuple[BoolArray, list[StepRecord]]:
    """Choose the pixels that become points."""
    height, width = z.shape
    keep = np.ones(z.shape, np.bool_)
    steps: list[StepRecord] = []

    def apply(name: str, passed: BoolArray, reason: str) -> None:
        nonlocal keep
        before = int(keep.sum())
        keep = keep & passed
        after = int(keep.sum())
        steps.append(
            StepRecord(name, before, after, {reason: before - after} if after < before else {})
        )
        if after == 0:
            raise UserError(
                f"{source}: {name}: expected pixels to remain, but all {before:,} were removed"
            )

    known = np.isfinite(z)
    apply("known_depth", known, "unknown")
    if settings.near is not None or settings.far is not None:
        low = 0.0 if settings.near is None else settings.near
        high = np.inf if settings.far is None else settings.far
        with np.errstate(invalid="ignore"):
            apply("near_far", (z >= low) & (z <= high), "too_near_or_far")
    if settings.min_confidence is not None:
        if depth.confidence is None:
            raise UserError(f"{source}: --min-confidence: the file has no confidence ('conf')")
        apply("confidence", depth.confidence >= settings.min_confidence, "low_confidence")
    if settings.crop_px is not None:
        x0, y0, x1, y1 = settings.crop_px
        inside = np.zeros(z.shape, np.bool_)
        inside[max(y0, 0) : max(y1, 0), max(x0, 0) : max(x1, 0)] = True
        apply("crop_px", inside, "outside")
    if settings.mask is not None:
        apply("mask", _mask(settings.mask, width, height), "masked")
    elif "A" in picture.getbands():
        alpha = picture.getchannel("A").resize((width, height), Image.Resampling.BOX)
        apply("alpha", np.asarray(alpha) >= 128, "transparent")
    if settings.flying_jump > 0:
        # judged on the whole depth: the mask's border is no depth edge
        flying = flying_pixels(np.where(known, z, np.nan), settings.flying_jump)
        apply("flying_pixels", ~flying, "flying")
    return keep, steps


def _mask(path: Path, width: int, height: int) -> BoolArray:
    """Read a mask picture at the depth's size.

    Raises:
        UserError: it cannot be read, has another aspect ratio, or is black.
    """
    shown = Image.fromarray(read_mask(path))
    if abs(shown.width / shown.height / (width / height) - 1.0) > 0.02:
        raise UserError(
            f"{path}: mask: expected the aspect ratio of {width} x {height}, found "
            f"{shown.width} x {shown.height}"
        )
    mask = np.asarray(shown.resize((width, height), Image.Resampling.NEAREST)) > 127
    if not mask.any():
        raise UserError(f"{path}: mask: expected white where the object is, found only black")
    return mask
