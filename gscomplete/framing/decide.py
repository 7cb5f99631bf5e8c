"""Decide the object frame and the view distribution V of a part: given, known, or guessed.

Conventions
-----------
* What the user gives is taken; what a known complete object says comes next; the rest is guessed
  from the part (``framing.guess``), with reasons.
* Centres and sizes are in the file frame; azimuth and elevation in degrees, as in ``views``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.framing.guess import guess_framing
from gscomplete.splats import Similarity, Splats, transform_splats
from gscomplete.util.parse import as_numbers, require_positive, shown_numbers
from gscomplete.views import (
    FrameOrigin,
    GivenOfFrame,
    ObjectFrame,
    UpAxis,
    ViewDistribution,
    parse_up,
    up_rotation,
)
from gscomplete.views.distribution import AZIMUTH_RANGE_DEG, ELEVATION_RANGE_DEG, FOV_DEG, RADIUS

_STEEPEST_DEG = 75.0
"""From a steeper elevation no side of P counts as the one behind."""


@dataclass(frozen=True, slots=True)
class FramingRequest:
    """What the user says about frame and views; None = decided here."""

    up: UpAxis = "Z"
    """File axis that points up."""
    view_deg: tuple[float, float] | None = None
    """Azimuth and elevation of the input view c."""
    azimuth_range_deg: float = AZIMUTH_RANGE_DEG
    """V reaches this far to either side of c."""
    center_file: tuple[float, float, float] | None = None
    """Centre of the complete object."""
    size_file: float | None = None
    """Largest side of the complete object."""
    camera_position_file: tuple[float, float, float] | None = None
    """Where the source was seen from: the input view, unless another one is given."""
    is_one_camera: bool = False
    """Whether all of the part was seen from there; what is missing then lies behind it."""
    elevation_range_deg: float = ELEVATION_RANGE_DEG
    """V reaches this far above and below c."""
    is_half: bool = False
    """Whether the part is one half of a symmetric object, cut along its plane of symmetry."""
    half_toward_deg: float | None = None
    """Rough azimuth of the other half, degrees; None = it is found."""

    def __post_init__(self) -> None:
        """Check what the user gives; any sequence of numbers becomes a tuple of them.

        Raises:
            UserError: the size is no length, the centre is not three finite numbers, up is no
                direction, or an angle is out of range.
        """
        if parse_up(self.up) is None:
            raise UserError("up: expected an axis or a direction, found None")
        if self.view_deg is not None:
            view = as_numbers(self.view_deg)
            if not (len(view) == 2 and abs(view[0]) < 1e6 and abs(view[1]) <= 90):
                raise UserError(
                    "view_deg: expected an azimuth and an elevation of -90 to 90 degrees, found "
                    + shown_numbers(self.view_deg)
                )
            object.__setattr__(self, "view_deg", view)
        for name, most in (("azimuth_range_deg", 180), ("elevation_range_deg", 90)):
            angle = getattr(self, name)
            if not (as_numbers([angle]) and 0 <= angle <= most):
                found = f"{angle:g}" if as_numbers([angle]) else repr(angle)
                raise UserError(f"{name}: expected 0 to {most} degrees, found {found}")
        if self.size_file is not None and not as_numbers([self.size_file]):
            raise UserError(f"--object-size: expected a positive length, found {self.size_file!r}")
        require_positive(self.size_file, "--object-size")
        if self.center_file is not None:
            center = as_numbers(self.center_file)
            if len(center) != 3 or not all(map(math.isfinite, center)):
                found = shown_numbers(self.center_file)
                raise UserError(f"--center: expected three finite numbers, found {found}")
            object.__setattr__(self, "center_file", center)


@dataclass(frozen=True, slots=True)
class Framing:
    """Frame and views of an object, and how they were found."""

    frame: ObjectFrame
    origin: FrameOrigin
    given: tuple[GivenOfFrame, ...]
    views: ViewDistribution
    notes: tuple[str, ...]
    """Reasons for what was guessed, for the user."""


def frame_about(complete: Splats, request: FramingRequest) -> ObjectFrame:
    """Return the frame of a complete object; the user's centre and size replace its box's."""
    own = ObjectFrame.about(complete, request.up)
    center, size = request.center_file or own.center_file, request.size_file or own.size_file
    return ObjectFrame(request.up, center, size)


def decide_framing(
    partial: Splats,
    request: FramingRequest,
    complete: Splats | None = None,
    *,
    radius: float = RADIUS,
    fov_deg: float = FOV_DEG,
) -> Framing:
    """Decide frame and views.

    Args:
        partial: P in the file frame.
        request: what the user gives.
        complete: the complete object in the file frame, where it is known.
        radius: distance of V's cameras from the centre, object sizes.
        fov_deg: their vertical field of view.

    Returns:
        The frame, V, and the reasons for what was guessed.

    Raises:
        UserError: a guess is needed and the part has no finite splat or no extent.
    """
    center, size, view = request.center_file, request.size_file, request.view_deg
    origin: FrameOrigin = "given"
    notes: tuple[str, ...] = ()
    if complete is not None and (center is None or size is None):
        known = frame_about(complete, request)
        center, size, origin = known.center_file, known.size_file, "truth"
    is_boxed = center is not None and size is not None
    camera = request.camera_position_file if view is None else None
    is_viewed = view is not None or camera is not None
    if not (is_boxed and is_viewed):
        if not len(partial):
            raise UserError("framing: P has no splat")
        rotation = up_rotation(request.up)
        anchor = partial.means.double().median(dim=0).values
        level = transform_splats(partial, Similarity(1.0, rotation, -(rotation @ anchor)))
        seen_from_deg = _azimuth_of_camera(partial, request)
        guess = guess_framing(
            level,
            seen_from_deg=seen_from_deg,
            is_half=request.is_half,
            half_toward_deg=request.half_toward_deg,
        )
        notes = guess.notes
        notes += () if is_viewed else (guess.view_reason,)
        notes += () if is_boxed else (guess.box_reason,)
        if center is None:
            lifted = rotation.T @ torch.tensor(guess.center, dtype=torch.float64) + anchor
            x, y, z = lifted.tolist()
            center, origin = (x, y, z), "guess"
        if size is None:
            size, origin = guess.size, "guess"
        view = view or (guess.view_azimuth_deg, guess.view_elevation_deg)
    assert center is not None
    assert size is not None
    frame = ObjectFrame(request.up, center, size)
    if camera is not None:
        view = view_from_position(frame, camera)
    assert view is not None
    views = ViewDistribution(
        *view,
        azimuth_range_deg=request.azimuth_range_deg,
        elevation_range_deg=request.elevation_range_deg,
        radius=radius,
        fov_deg=fov_deg,
    )
    given: list[GivenOfFrame] = []
    given += ["center"] if request.center_file is not None else []
    given += ["size"] if request.size_file is not None else []
    return Framing(frame, origin, tuple(given), views, notes)


def _azimuth_of_camera(partial: Splats, request: FramingRequest) -> float | None:
    """Return the azimuth of the one camera that saw the part; None = there is no such camera."""
    if request.camera_position_file is None or not request.is_one_camera:
        return None
    frame = ObjectFrame.about(partial, request.up)
    azimuth, elevation = view_from_position(frame, request.camera_position_file)
    return azimuth if abs(elevation) <= _STEEPEST_DEG else None


def view_from_position(
    frame: ObjectFrame, position_file: tuple[float, float, float]
) -> tuple[float, float]:
    """Return azimuth and elevation in degrees of a camera position seen from the centre."""
    point = torch.tensor(position_file, dtype=torch.float64)
    x, y, z = frame.object_from_file.apply(point).tolist()
    return (
        float(np.degrees(np.arctan2(y, x)) % 360.0),
        float(np.degrees(np.arctan2(z, np.hypot(x, y)))),
    )
