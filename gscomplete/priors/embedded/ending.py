"""What P lacks, by how its surface ends: nothing, its mirror image, or what has to be guessed.

P counts as cut along a plane of symmetry if its rim leaves no doubt (``CutPlane.is_symmetric``) or
if the user says so.

Conventions
-----------
* Object frame, z up; the frame's centre is the origin that offsets of planes count from.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gscomplete.framing.cut_plane import CutPlane, find_cut
from gscomplete.framing.end_plane import find_end
from gscomplete.framing.extent import Exposure, is_closed, thickness_of
from gscomplete.framing.guess import score_partial
from gscomplete.shape.mirror_plane import HalfCut, Mirror, MirrorPlane
from gscomplete.splats import Splats
from gscomplete.splats.geometry.neighbourhood import flat_axes
from gscomplete.splats.geometry.upright_plane import UprightPlane
from gscomplete.util.arrays import Float32Array, Float64Array

_LEAST_SHARE = 1e-3

_COMPLETE_NOTE = (
    "P's surface is closed: P is taken to be complete, and nothing is added "
    "(--mirror none completes it all the same)"
)
_SQUARE_CUT_NOTE = (
    "P ends at a plane that its surface meets squarely: P is mirrored through that plane "
    "(--alternatives 4 draws other guesses)"
)
_PLANE_NOTE = (
    "P seems cut along the upright plane {plane}; if it is one half of something symmetric about "
    "that plane, give --mirror cut"
)
_LEAST_TOLD = 0.3
"""Users are told of cuts of at least this squareness. Of 840 train objects, 607 halves through the
middle, 473 other halves, 97 arcs, 61 scans, 58 boxes and 51 complete objects have one of .4."""


@dataclass(frozen=True, slots=True)
class Ending:
    """How P ends, as far as it was found or the user says."""

    mirror: Mirror
    """The plane that it is to be mirrored through."""
    in_plane: bool
    """Whether P was cut along a plane, of symmetry or not."""
    image_is_all: bool = False
    """Whether all that P lacks is its image through ``mirror``."""
    is_complete: bool = False
    """Whether P lacks nothing."""
    notes: tuple[str, ...] = ()
    """The reason, or what the user may do, for the user."""
    features: Float32Array | None = None  # [len(benefit.OF_ENDING)]
    """Numbers that tell whether P lacks anything; None = this is known, or the user decides."""


def ending_of(
    partial: Splats,
    wish: Mirror,
) -> Ending:
    """Return how P ends, and through which plane it is to be mirrored.

    Args:
        partial: P in the object frame.
        wish: the mirror plane that the user asks for, "guess" or "none".
    """
    points = partial.means.double().numpy()
    cut = find_cut(points, flat_axes(partial))
    in_plane = ends_in_plane(cut)
    if wish != "guess":
        return Ending(wish, in_plane)
    exposure = Exposure(points)
    if is_closed(points, cut, lambda: score_partial(partial).openness()[1], exposure):
        return Ending("guess", in_plane, is_complete=True, notes=(_COMPLETE_NOTE,))
    if cut is not None and cut.is_symmetric and abs(cut.offset) <= 1:
        notes = (_SQUARE_CUT_NOTE,)
        return Ending(_mirror_through(cut), in_plane, image_is_all=True, notes=notes)
    # The scorer that reads the features was trained on cuts found by places alone.
    features = features_of_ending(points, find_cut(points), exposure)
    told: tuple[str, ...] = ()
    if cut is not None and cut.squareness >= _LEAST_TOLD and abs(cut.offset) <= 1:
        told = (_PLANE_NOTE.format(plane=_mirror_through(cut)),)
    return Ending("guess", in_plane, notes=told, features=features)


def features_of_ending(
    points: Float64Array,  # [N, 3] of P, object frame
    cut: CutPlane | None,
    exposure: Exposure,
) -> Float32Array:  # [len(OF_ENDING)]
    """Return the features of P that tell whether it lacks anything; columns as ``OF_ENDING``."""
    of_cut = (0.0,) * 4
    if cut is not None:
        of_cut = (1.0, cut.squareness, float(cut.meets_surface), cut.offset)
    shares = exposure.with_few, exposure.with_many
    logs = [math.log(share + _LEAST_SHARE) for share in shares]
    return np.array([*logs, thickness_of(points), *of_cut], np.float32)


def mirror_of_half(
    partial: Splats,
    cut: CutPlane | None,
    half: HalfCut,
) -> MirrorPlane | None:
    """Return the plane that P, one half of an object, ends at; None = none is found.

    Args:
        partial: P.
        cut: the cut that ``find_cut`` finds in it.
        half: what the user says about the half.
    """
    points = partial.means.double().numpy()
    end = find_end(points, cut, half.toward_deg, flat_axes(partial))
    return None if end is None or abs(end.offset) > 1 else _mirror_through(end)


def ends_in_plane(cut: CutPlane | None) -> bool:
    """Say whether P was cut along a plane, as far as found."""
    return cut is not None and cut.meets_surface


def _mirror_through(plane: UprightPlane) -> MirrorPlane:
    return MirrorPlane(plane.azimuth_deg, plane.offset)
