"""Decide where the whole object is and how it is looked at, for an object's record.

Conventions
-----------
* What the user gives is taken; what the known whole says comes next; the rest is guessed from the
  part as ``gscomplete complete`` would (``gscomplete.framing``), with reasons.
* The box of a known whole is that of the middle 99.9 % of its splats along every axis, since
  trained splats have floaters; centres and sizes are in the file frame.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.splats import Similarity, Splats, transform_splats
from gscomplete.views import ObjectFrame, UpAxis, ViewDistribution, up_rotation

SPLAT_FILE_UP: UpAxis = "-Y"
"""What points up in a splat file that nothing more is known of, as in most trained ones."""
_STEEPEST_DEG = 75.0
"""From steeper above no side is behind."""
UP_ASSUMED = "no cameras are known: the up axis is taken to be -Y unless --up says otherwise"
"""Note of an object whose up axis that decided."""


@dataclass(frozen=True, slots=True)
class FramingRequest:
    """What the user says about frame and views; None = decided here."""

    up: UpAxis
    """File axis that points up."""
    view_deg: tuple[float, float] | None = None
    """Azimuth and elevation of the input view c."""
    azimuth_range_deg: float = 50.0
    """V reaches this far to either side of c."""
    center_file: tuple[float, float, float] | None = None
    """Centre of the whole object."""
    size_file: float | None = None
    """Largest side of the whole object."""
    camera_position_file: tuple[float, float, float] | None = None
    """Where the source was seen from: the input view, unless another one is given."""
    is_one_camera: bool = False
    """Whether all of the part was seen from there: the whole then lies behind the part."""


@dataclass(frozen=True, slots=True)
class Framing:
    """Frame and views of an object, and how they were found."""

    frame: ObjectFrame
    origin: Literal["truth", "guess", "given"]
    views: ViewDistribution
    notes: tuple[str, ...]


def decide_framing(partial: Splats, complete: Splats | None, request: FramingRequest) -> Framing:
    """Decide frame and views.

    Raises:
        UserError: a guess is needed and the part has no finite splat or no extent.
    """
    from gscomplete.framing.guess import guess_framing

    center, size, view = request.center_file, request.size_file, request.view_deg
    origin: Literal["truth", "guess", "given"] = "given"
    notes: list[str] = []
    if complete is not None and (center is None or size is None):
        whole = ObjectFrame.about(complete, request.up)
        center, size, origin = center or whole.center_file, size or whole.size_file, "truth"
    is_boxed = center is not None and size is not None
    camera = request.camera_position_file if view is None else None
    if not is_boxed or (view is None and camera is None):
        rotation = up_rotation(request.up)
        anchor = partial.means.double().median(dim=0).values
        level = transform_splats(partial, Similarity(1.0, rotation, -(rotation @ anchor)))
        guess = guess_framing(level, seen_from_deg=_azimuth_of_camera(partial, request))
        notes += guess.reasons(view=view is None and camera is None, box=not is_boxed)
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
    views = ViewDistribution(*view, azimuth_range_deg=request.azimuth_range_deg)
    return Framing(frame, origin, views, tuple(notes))


def _azimuth_of_camera(partial: Splats, request: FramingRequest) -> float | None:
    """Return the azimuth of the one camera that saw the part; None = there is no such camera."""
    if request.camera_position_file is None or not request.is_one_camera:
        return None
    frame = ObjectFrame.about(partial, request.up)
    azimuth, elevation = view_from_position(frame, request.camera_position_file)
    return azimuth if abs(elevation) <= _STEEPEST_DEG else None


def moved_center(request: FramingRequest, file_from_source: Similarity) -> FramingRequest:
    """Take the centre, where one is given, from the source's frame to the file's."""
    if request.center_file is None:
        return request
    center = torch.tensor(request.center_file, dtype=torch.float64)
    x, y, z = file_from_source.apply(center).tolist()
    return dataclasses.replace(request, center_file=(x, y, z))


def require_touching(
    frame: ObjectFrame, part: Splats, file_from_source: Similarity | None = None
) -> None:
    """Refuse a frame that the user gave and in whose box no splat of the part lies.

    Args:
        frame: the frame.
        part: the splats; those that are not finite do not count.
        file_from_source: the error names coordinates of the source's frame; None = the file's.

    Raises:
        UserError: the box, larger by a splat's size on every side, holds no splat.
    """
    means = part.means.double()
    means = means[torch.isfinite(means).all(dim=1)]
    reach = 0.5 + part.typical_size / frame.size_file
    if len(means) == 0 or bool((frame.object_from_file.apply(means).abs() <= reach).all(1).any()):
        return
    center = torch.tensor(frame.center_file, dtype=torch.float64)
    if file_from_source is not None:
        back = file_from_source.inverse()
        means, center = back.apply(means), back.apply(center)
    low, high, middle = (
        ",".join(f"{value:.9g}" for value in point.tolist())
        for point in (means.amin(dim=0), means.amax(dim=0), center)
    )
    raise UserError(
        f"--center, --size-whole: expected a box that holds some of the part, which spans {low} to "
        f"{high}; found the box of side {frame.size_file:.9g} around {middle}"
    )


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
