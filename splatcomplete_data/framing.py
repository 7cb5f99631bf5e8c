"""Decide where the whole object is and how it is looked at, for an object's record.

Conventions
-----------
* What the user gives is taken; what the known whole says comes next; the rest is guessed from the
  part as ``gscomplete complete`` would (``completion.framing``), with reasons.
* The box of a known whole is that of the middle 99.9 % of its splats along every axis, since
  trained splats have floaters; centres and sizes are in the file frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch

from gscomplete.splats import Similarity, Splats, transform_splats
from gscomplete.views import ObjectFrame, UpAxis, ViewDistribution, up_rotation

SPLAT_FILE_UP: UpAxis = "-Y"
"""What points up in a splat file that nothing more is known of, as in most trained ones."""
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


@dataclass(frozen=True, slots=True)
class Framing:
    """Frame and views of an object, and how they were found."""

    frame: ObjectFrame
    origin: Literal["truth", "guess", "given"]
    views: ViewDistribution
    notes: tuple[str, ...]


def frame_of_whole(splats: Splats, up: UpAxis) -> ObjectFrame:
    """Return the object frame of a complete object."""
    return ObjectFrame.about(splats, up)


def decide_framing(partial: Splats, complete: Splats | None, request: FramingRequest) -> Framing:
    """Decide frame and views.

    Raises:
        UserError: a guess is needed and the part has no finite splat or no extent.
    """
    from gscomplete.completion.framing import guess_framing

    center, size, view = request.center_file, request.size_file, request.view_deg
    origin: Literal["truth", "guess", "given"] = "given"
    notes: list[str] = []
    if complete is not None and (center is None or size is None):
        whole = frame_of_whole(complete, request.up)
        center, size, origin = center or whole.center_file, size or whole.size_file, "truth"
    is_boxed = center is not None and size is not None
    camera = request.camera_position_file if view is None else None
    if not is_boxed or (view is None and camera is None):
        rotation = up_rotation(request.up)
        anchor = partial.means.double().median(dim=0).values
        level = transform_splats(partial, Similarity(1.0, rotation, -(rotation @ anchor)))
        guess = guess_framing(level)
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
