"""From points to a finished part: boxes, cleaning, levelling, thinning, fixed-size splats.

Shared by scans and single views, which differ only in where their points come from.

Conventions
-----------
* Boxes and ``seed_point`` are in the source's frame, before levelling.
* Planes are looked for in the complete cloud; boxes then say what is kept of it.
* Levelling rotates the cloud about its origin so that the first plane removed, or else the floor or
  table of the scene, is horizontal (z up). The rotation is returned and recorded. Users are warned
  if the object then hangs below that plane, or if the rotation turns it upside down.
* If the cloud is too far from the origin for float32, an offset is subtracted before the rotation
  (``points``); it is returned and recorded as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from gscomplete.errors import UserError, naming
from gscomplete.splats import Similarity, Splats
from gscomplete.util.arrays import BoolArray, Float64Array
from gscomplete.util.device import plain_torch
from splatcomplete_data.cuts.boxes import CropBox, inside_boxes
from splatcomplete_data.objects import StepRecord
from splatcomplete_data.points import (
    Offset,
    PointSplatSettings,
    median_spacing,
    offset_for_float32,
    points_to_splats,
    sigma_of,
    thin_to_count,
    thin_to_spacing,
    without_offset,
)
from splatcomplete_data.scan.clean import (
    DOUBTFUL_SHARE,
    CleanSettings,
    Surroundings,
    clean,
    level_rotation,
)
from splatcomplete_data.scan.cloud import PointCloud
from splatcomplete_data.scan.support import PlaneSettings, SupportPlane, find_level_plane

Level = Literal["auto", "always", "never"]
_UNLEVELLED = (
    "up is that of the picture, as no floor or table was found to level on; if the camera looked "
    "down, the object leans (--up gives another)"
)


@dataclass(frozen=True, slots=True)
class PartSettings:
    """Steps from points to splats, and their knobs."""

    boxes: tuple[CropBox, ...] = ()
    """Boxes that keep or remove, source frame."""
    cleaning: CleanSettings | None = None
    """Planes, outliers and clutter; None = nothing is cleaned."""
    level: Level = "auto"
    """When to rotate the cloud so that the first plane found is horizontal. ``auto``: if up is
    known only from a picture, and if there is a plane. ``always``: fails without a plane.
    ``never``."""
    count: int | None = None
    """Thin to at most this many points; None = keep all."""
    spacing: float | None = None
    """Thin to one point per cube of this side; None = keep all."""
    sigma: float | None = None
    """Standard deviation of the splats, source units; None = from the spacing."""
    sigma_per_spacing: float = 0.6
    """Standard deviation over spacing, if ``sigma`` is None."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """The finished part, and what happened to every point."""

    splats: Splats
    sigma: float
    steps: tuple[StepRecord, ...]
    offset: Offset | None
    """Subtracted from the source's coordinates; None = nothing."""
    turn: Similarity | None
    """Rotation from the source's frame without offset to the splats' frame; None = identity."""
    cloud: PointCloud
    """All points within the boxes, source frame."""
    reason: NDArray[np.int8]  # [N] of ``cloud``: why a point was removed, -1 = kept
    reasons: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    """Why the part may be wrong, with numbers, for the user."""

    @property
    def file_from_source(self) -> Similarity | None:
        """Similarity from the source's frame to the splats'; None = identity."""
        if self.offset is None:
            return self.turn
        moved = without_offset(self.offset)
        return moved if self.turn is None else self.turn.compose(moved)


@plain_torch()
def make_part(
    cloud: PointCloud,
    settings: PartSettings,
    source: str,
    around: Surroundings | None = None,
) -> Part:
    """Turn points into the splats of one object.

    Args:
        cloud: finite points.
        settings: the steps.
        source: the file named in errors.
        around: position of the scanner, which is on a plane's upper side, and the up direction.
            Without a position, the upper side is the one that most of the kept points lie on.

    Raises:
        UserError: a step keeps no point, or levelling is asked for and no plane was found.
    """
    with naming(source):
        return _made(cloud, settings, source, around or Surroundings())


def _made(cloud: PointCloud, settings: PartSettings, source: str, known: Surroundings) -> Part:
    """Turn points into splats as ``make_part`` does."""
    steps: list[StepRecord] = []
    scene, wanted = cloud, np.ones(len(cloud), np.bool_)
    if settings.boxes:
        wanted = inside_boxes(cloud.points, settings.boxes)
        before, after = len(cloud), int(wanted.sum())
        steps.append(StepRecord("boxes", before, after, {"outside_boxes": before - after}))
        if after == 0:
            low, high = cloud.points.min(axis=0).round(3), cloud.points.max(axis=0).round(3)
            raise UserError(
                f"{source}: --box: expected points inside, found none of {before:,} (they span "
                f"{low.tolist()} to {high.tolist()})"
            )
        cloud = cloud.select(np.flatnonzero(wanted))
    reason = np.full(len(cloud), -1, np.int8)
    reasons: tuple[str, ...] = ()
    planes: tuple[SupportPlane, ...] = ()
    warnings: tuple[str, ...] = ()
    if settings.cleaning is not None:
        cleaned = clean(scene, settings.cleaning, wanted=wanted, around=known)
        reason, reasons, planes = cleaned.reason, cleaned.reasons, cleaned.planes
        steps += cleaned.steps
        warnings = cleaned.warnings
    kept = cloud.select(np.flatnonzero(reason < 0))
    kept, thinning = _thin(kept, settings)
    steps += thinning
    turn = None
    if settings.level == "always" or (settings.level == "auto" and known.is_picture_up):
        plane = _plane_to_level_on(scene, planes, settings, known)
        if plane is None and settings.level == "always":
            raise UserError(
                f"{source}: --level: expected a plane to level on, found none"
                + "".join(f"; {warning}" for warning in warnings)
            )
        if plane is None:
            warnings = (*warnings, _UNLEVELLED)
        else:
            turn, told = _levelled(plane, kept.points, known)
            warnings = (*warnings, *told)
    per_spacing = PointSplatSettings(sigma_per_spacing=settings.sigma_per_spacing)
    points, sigma = _turned(kept.points, turn), settings.sigma
    if sigma is None:
        sigma = sigma_of(points, per_spacing)
    offset = offset_for_float32(kept.points.min(axis=0), kept.points.max(axis=0), sigma)
    if offset is not None:
        points = _turned(kept.points - offset, turn)
    splats = points_to_splats(points, kept.colors, per_spacing, sigma=sigma)
    size = float(splats.scales[0, 0])
    return Part(splats, size, tuple(steps), offset, turn, cloud, reason, reasons, warnings)


def _plane_to_level_on(
    cloud: PointCloud, planes: tuple[SupportPlane, ...], settings: PartSettings, known: Surroundings
) -> SupportPlane | None:
    """Return the first plane removed, else the floor or table of the scene, if there is one."""
    if planes:
        return planes[0]
    points = cloud.points if known.scene is None else known.scene
    return find_level_plane(
        points,
        median_spacing(points, 20_000),
        PlaneSettings() if settings.cleaning is None else settings.cleaning.plane,
        up=None if known.up is None else np.asarray(known.up, np.float64),
        viewpoint=None if known.viewpoint is None else np.asarray(known.viewpoint, np.float64),
    )


def _levelled(
    plane: SupportPlane,
    kept: Float64Array,  # [N, 3]
    known: Surroundings,
) -> tuple[Similarity, tuple[str, ...]]:
    """Return the rotation that makes a plane level, and warnings about it."""
    above = kept if known.viewpoint is None else np.asarray(known.viewpoint, np.float64)
    rotation = level_rotation(plane.plane, above)
    height = kept @ rotation[2] - float(plane.foot @ rotation[2])
    doubts = []
    if known.is_picture_up and known.up is not None:
        lean = np.degrees(np.arccos(np.clip(rotation[2] @ np.asarray(known.up), -1, 1)))
        doubts.append(
            f"levelled on a plane of {int(plane.inside.sum()):,} points: turned by {lean:.0f} "
            "degrees from the picture's up (--keep-tilt does not)"
        )
    under = float((height < 0).mean())
    if under > DOUBTFUL_SHARE:
        doubts.append(
            f"doubtful: {100 * under:.0f} % of the points lie below the plane used for levelling, "
            "as seen from the scanner"
        )
    if known.up is not None and rotation[2] @ np.asarray(known.up) < 0:
        angle = float(np.degrees(np.arccos(np.clip(rotation[2] @ np.asarray(known.up), -1, 1))))
        doubts.append(
            f"doubtful: levelling turns the object by {angle:.0f} degrees, upside down; "
            "--viewpoint X,Y,Z tells on which side the scanner was"
        )
    return Similarity(1.0, torch.from_numpy(rotation), torch.zeros(3)), tuple(doubts)


def _turned(points: Float64Array, turn: Similarity | None) -> Float64Array:
    """Turn points in float64."""
    if turn is None:
        return points
    turned: Float64Array = turn.apply(torch.from_numpy(points)).numpy()
    return turned


def _thin(cloud: PointCloud, settings: PartSettings) -> tuple[PointCloud, list[StepRecord]]:
    """Thin to a spacing, then to a count."""
    steps = []
    if settings.spacing is not None:
        mask = thin_to_spacing(cloud.points, settings.spacing)
        steps.append(_thinned(len(cloud), mask, settings.spacing))
        cloud = cloud.select(np.flatnonzero(mask))
    if settings.count is not None:
        mask, spacing = thin_to_count(cloud.points, settings.count)
        steps.append(_thinned(len(cloud), mask, spacing))
        cloud = cloud.select(np.flatnonzero(mask))
    return cloud, steps


def _thinned(before: int, mask: BoolArray, spacing: float) -> StepRecord:
    """Record a thinning."""
    after = int(mask.sum())
    removed = {"closer_than_spacing": before - after} if after < before else {}
    return StepRecord("thin", before, after, removed, f"one point per {spacing:.4g}")
