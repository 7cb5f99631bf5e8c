"""Named ways to cut a part out of a complete object, as text and as values.

Conventions
-----------
* Cuts are given in the object frame of the complete object: z up, centred on its box, largest
  side 1, unless the user gives another centre or size (``framing.decide.frame_about``). They
  return a mask with its reason (``geometry.PartialCut``) and change no splat.
* As text: ``plane:AZIMUTH[,OFFSET]`` takes away what lies beyond an upright plane towards that
  azimuth, at a signed distance from the centre; ``box:LX,LY,LZ,HX,HY,HZ`` keeps what lies inside;
  ``scan:AZ/EL[,AZ/EL...]`` keeps what a scanner sees from those directions.
* Several cuts keep what all of them keep.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.splats import Splats, transform_splats
from gscomplete.util.arrays import Float64Array
from gscomplete.views import ObjectFrame
from splatcomplete_data.cuts.boxes import CropBox, inside_boxes
from splatcomplete_data.cuts.geometry import (
    PartialCut,
    by_plane,
    crop,
    eyes_at,
    looking_rotation,
)
from splatcomplete_data.cuts.transmittance import seen_splats
from splatcomplete_data.objects import StepRecord

SCAN_DISTANCE = 2.2
"""Distance of a scanner from the centre, in object sizes (as ``ViewDistribution.radius``)."""
_SCAN_WIDTH = 2.54
"""What a scanner's image spans at the centre, in object sizes."""
_MAX_SCAN_CELLS = 1024
"""Most cells along a side of the image in which splats are looked up."""
_SCAN_FOV_DEG = 60.0
_OBJECT_SHARE = 0.995
"""Share of the splats that a scanner's picture is wide enough for; the rest may be floaters."""
_MOST_REACH = 1.0
"""Object sizes from the centre; the corners of the object's box are nearer."""
FORMS = "plane:AZIMUTH[,OFFSET], box:LX,LY,LZ,HX,HY,HZ or scan:AZ/EL[,AZ/EL...]"


@dataclass(frozen=True, slots=True)
class PlaneCut:
    """Take away everything beyond an upright plane."""

    toward_deg: float
    """Azimuth of the side taken away."""
    offset: float = 0.0
    """Signed distance of the plane from the centre, in object sizes."""

    def apply(self, complete: Splats) -> PartialCut:
        """Return what is kept of splats in the object frame."""
        angle = math.radians(self.toward_deg)
        return by_plane(complete, (-math.cos(angle), -math.sin(angle), 0.0), -self.offset)


@dataclass(frozen=True, slots=True)
class BoxCut:
    """Keep what lies inside a box."""

    low: tuple[float, float, float]
    """Lower corner in the object frame."""
    high: tuple[float, float, float]
    """Upper corner in the object frame."""

    def apply(self, complete: Splats) -> PartialCut:
        """Return what is kept of splats in the object frame."""
        return crop(complete, self.low, self.high)


@dataclass(frozen=True, slots=True)
class ScanCut:
    """Keep what a scanner sees."""

    directions_deg: tuple[tuple[float, float], ...]
    """Azimuth and elevation of every viewpoint."""

    @property
    def eyes(self) -> Float64Array:  # [V, 3]
        """Where the scanner stands, object frame."""
        azimuths, elevations = np.deg2rad(np.array(self.directions_deg, np.float64)).T
        return eyes_at(azimuths, elevations, SCAN_DISTANCE)

    def apply(self, complete: Splats) -> PartialCut:
        """Return what is kept of splats in the object frame."""
        eyes = self.eyes
        # One or two cells per splat, so that each cell holds only a few.
        typical = float(complete.scales.amax(dim=1).median())
        grid = int(np.clip(_SCAN_WIDTH / max(1.3 * typical, 1e-9), 64, _MAX_SCAN_CELLS))
        middle = np.zeros(3)
        reach = float(np.quantile(complete.means.double().norm(dim=1).numpy(), _OBJECT_SHARE))
        reach = min(reach, _MOST_REACH)
        half = max(
            math.tan(math.radians(_SCAN_FOV_DEG / 2)), 1.05 * reach / (SCAN_DISTANCE - reach)
        )
        seen = np.zeros(len(complete), np.bool_)
        for eye in eyes:
            seen |= seen_splats(complete, eye, looking_rotation(eye, middle), grid, half)
        details = {"views": len(eyes), "eyes": eyes.round(3).tolist()}
        return PartialCut(torch.from_numpy(seen), "visibility", details)


Cut = PlaneCut | BoxCut | ScanCut


def parse_cut(text: str, option: str = "--cut") -> Cut:
    """Read a cut from text (module conventions).

    Raises:
        UserError: the text has another form.
    """
    kind, _, rest = text.partition(":")
    try:
        if kind == "scan":
            pairs = [tuple(map(_number, word.split("/"))) for word in rest.split(",")]
            if all(len(pair) == 2 and abs(pair[1]) <= 90 for pair in pairs):
                return ScanCut(tuple((pair[0], pair[1]) for pair in pairs))
        values = [_number(word) for word in rest.split(",")]
        if kind == "plane" and len(values) in (1, 2):
            return PlaneCut(*values)
        if kind == "box" and len(values) == 6 and all(np.less(values[:3], values[3:])):
            return BoxCut((values[0], values[1], values[2]), (values[3], values[4], values[5]))
    except ValueError:
        pass
    raise UserError(f"{option}: expected {FORMS}, found {text!r}")


def scanner_position(cuts: Sequence[Cut], frame: ObjectFrame) -> tuple[float, float, float] | None:
    """Return where the one scanner stood, in the file frame; None = there were none or several.

    Args:
        cuts: cuts in the object frame.
        frame: the object frame.
    """
    scans = [cut for cut in cuts if isinstance(cut, ScanCut)]
    places = {place for cut in scans for place in cut.directions_deg}
    if len(places) != 1:
        return None
    eye = torch.from_numpy(scans[0].eyes[0])
    x, y, z = frame.object_from_file.inverse().apply(eye).tolist()
    return (x, y, z)


def apply_cuts(
    complete: Splats,
    frame: ObjectFrame,
    cuts: Sequence[Cut],
    boxes: Sequence[CropBox],
    source: str,
) -> tuple[Splats, tuple[StepRecord, ...]]:
    """Cut a part out of complete splats in the file frame.

    Args:
        complete: the complete object, file frame.
        frame: its object frame.
        cuts: cuts in the object frame.
        boxes: boxes in the file frame, applied after the cuts.
        source: the file named in errors.

    Returns:
        The part, file frame, and a record of every cut.

    Raises:
        UserError: the cuts keep nothing, or everything.
    """
    plain = complete.as_read()
    level = transform_splats(plain, frame.object_from_file)
    mask = torch.ones(len(level), dtype=torch.bool)
    steps = []
    for cut in cuts:
        result = cut.apply(level)
        before = int(mask.sum())
        mask = mask & result.mask
        after = int(mask.sum())
        removed: dict[str, int] = {result.kind: before - after} if after < before else {}
        steps.append(StepRecord(f"cut_{result.kind}", before, after, removed, result.reason))
    if boxes:
        before = int(mask.sum())
        mask = mask & torch.from_numpy(inside_boxes(plain.means.numpy(), boxes))
        after = int(mask.sum())
        steps.append(StepRecord("boxes", before, after, {"outside_boxes": before - after}))
    kept = int(mask.sum())
    if kept in (0, len(level)):
        what = "nothing" if kept == 0 else "everything"
        raise UserError(
            f"{source}: cut: expected to keep a part of {len(level)} splats, kept {what}"
        )
    return complete.select(mask.to(complete.means.device)), tuple(steps)


def _number(word: str) -> float:
    """Parse a finite number."""
    value = float(word)
    if not math.isfinite(value):
        raise ValueError(word)
    return value
