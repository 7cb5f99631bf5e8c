"""Check a frame that the user gives against P, and describe the frame and view that are used.

Conventions
-----------
* File frame and file units; P's box leaves out the farthest 0.1 % of its splats on each side.
"""

from __future__ import annotations

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.render import render
from gscomplete.splats import Splats
from gscomplete.splats.filters import near_rows
from gscomplete.util.arrays import Float64Array
from gscomplete.views import ObjectFrame, ViewDistribution

_LEAST_SHARE = 0.01
_LARGEST_SHARE = 10.0
"""Bounds of P's largest side over the complete object's. Outside them the frame is a mistake,
mostly of units. The upper one exceeds 1 because P may include some of what stands around the
object."""
_SMALL_SHARE = 0.05
"""Users are told if P's share is smaller."""
_COARSE_SHARE = 1e-3
"""Users are told if float32 coordinates at the object are farther apart than this share of its
size. The limit is about a quarter of a pixel where the object fills 256."""
_VISIBILITY_PX = 128
"""Side of the picture in which P must be seen."""


def largest_side(splats: Splats) -> float:
    """Return the largest side of the splats' box (``_middle_box``).

    If the splats are larger than this box, return their median size instead: a single splat may
    have any size.
    """
    low, high = _middle_box(splats)
    return max(float((high - low).max()), splats.typical_size)


def check_given_frame(partial: Splats, frame: ObjectFrame, name: str) -> tuple[str, ...]:
    """Check that a frame given by the user may be that of the complete object.

    The usual mistake is a wrong unit. The run would then add only a few splats, or specks on P's
    surface, and its metrics would not show that anything is wrong.

    Args:
        partial: P, in the file frame.
        frame: the frame of the complete object.
        name: P's file, for errors.

    Returns:
        Warnings for the user.

    Raises:
        UserError: P is tiny in the frame, many times as large as it, or lies outside it.
    """
    near, _ = near_rows(partial)  # one splat may be astronomically far away
    side, size = largest_side(partial.select(near)), frame.size_file
    share = side / size
    sides = (
        f"P's largest side is {side:.4g}, {100 * share:.2g} % of the complete object's {size:.4g} "
        "(--object-size)"
    )
    if not _LEAST_SHARE <= share <= _LARGEST_SHARE:
        raise UserError(
            f"{name}: --object-size: expected {side / _LARGEST_SHARE:.4g} to "
            f"{side / _LEAST_SHARE:.4g} (file units), found {size:.4g}; {sides}"
        )
    low, high = _middle_box(partial)
    center = np.array(frame.center_file)
    beyond = float(np.maximum(center - low, high - center).max()) / size - 0.5
    if bool((low > center + size / 2).any() or (high < center - size / 2).any()):
        raise UserError(
            f"{name}: --center, --object-size: expected a frame that P lies in; P reaches from "
            f"{_point(low)} to {_point(high)}, the frame from {_point(center - size / 2)} to "
            f"{_point(center + size / 2)} (file units)"
        )
    notes = [f"{sides}: check that both are in the same unit"] if share < _SMALL_SHARE else []
    if beyond > 0.5:
        notes.append(
            f"P reaches {beyond * size:.4g} beyond the frame of size {size:.4g}: check that the "
            "frame is that of the complete object (--center, --object-size)"
        )
    return tuple(notes)


def describe_frame(frame: ObjectFrame, views: ViewDistribution) -> tuple[str, ...]:
    """Tell the user which frame and input view were taken, and what limits their precision."""
    x, y, z = frame.center_file
    size = frame.size_file
    notes = [
        f"frame: up {frame.up}, centre {x:.9g},{y:.9g},{z:.9g}, size {size:.6g} (file "
        f"units), input view {views.azimuth_deg:g},{views.elevation_deg:g} degrees"
    ]
    spacing = float(np.spacing(np.float32(max(map(abs, frame.center_file)))))
    if spacing > _COARSE_SHARE * size:
        notes.append(
            f"the object is far from the origin: float32 coordinates there are {spacing:.3g} "
            f"apart, {100 * spacing / size:.2g} % of its size, which limits how exactly splats lie"
        )
    return tuple(notes)


def require_visible(partial: Splats, views: ViewDistribution, name: str) -> None:
    """Refuse a P that the input view does not show: nothing could be preserved or measured.

    Args:
        partial: P in the object frame.
        views: V about the input view.
        name: P's file, for errors.

    Raises:
        UserError: no pixel of the input view shows P.
    """
    with torch.no_grad():
        alpha = render(partial, views.input_camera(_VISIBILITY_PX)).alpha
    if not bool(alpha.any()):
        raise UserError(
            f"{name}: expected splats visible from the input view, found none; they are "
            "transparent, or --center, --object-size or --view is wrong"
        )


def _middle_box(splats: Splats) -> tuple[Float64Array, Float64Array]:  # [3], [3]
    """Return the box of the splats' centres, without the farthest 0.1 % on each side."""
    low, high = np.quantile(splats.means.double().numpy(), [0.001, 0.999], axis=0)
    return low, high


def _point(values: Float64Array) -> str:
    """Write a point as ``--center`` reads it."""
    return ",".join(f"{value:.4g}" for value in values)
