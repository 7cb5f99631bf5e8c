"""Reasons to doubt a completion, in words for whoever asked for it.

Conventions
-----------
* Everything is in the object frame, where the complete object's largest side was guessed as 1.
* A doubt names what was found, and the options that may help. It changes nothing.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.ndimage import label, sum_labels

from gscomplete.framing.input_view import MOST_HIDDEN
from gscomplete.splats import Splats
from gscomplete.splats.linear_values import linear_values_of
from gscomplete.splats.suspects import FEWEST

MARK = "doubtful: "
"""Begins each doubt among the notes of a run."""
_CELLS_OF_PIECES = 6
"""P is in pieces if a layer of empty cells separates them, with so many cells along P's largest
side, ..."""
_LEAST_PIECE = 0.1
"""... and if at least two pieces have more than this share of P's splats. This holds for 2 of 240
parts of 48 objects."""
_LEAST_BREADTH = 0.005
"""P is a line if its splats' middles deviate less across their main axis, over the deviation along
it."""
_MOST_COLOR_CHANGE, _MOST_DEPTH_CHANGE = 0.01, 0.03
"""A result is doubtful from larger E_color or E_depth over V on: one of 588 parts of 98 objects."""
_MOST_OF_SIZE = 1.1
"""P is too large for the size that the user gives from this largest side on (object sizes)."""
_LARGEST_SPLAT = 0.3
"""P is no surface if its splats are typically larger than this share of its largest side."""
_MOST_LOST = 0.5
"""A result is doubtful if bounds on E_color and E_depth removed or faded a larger share of the new
splats."""
_OPEN_SIDE = 0.9
"""A P with a shorter largest side (object sizes) was guessed to be open to one side. Its result is
doubtful ..."""
_LEAST_GROWTH = 0.25
"""... if the completion grows by a smaller share of what P's side lacks of the guessed size."""


def doubts_of_values(partial: Splats) -> tuple[str, ...]:
    """Return what indicates that P's file was written without the conversions of such files.

    Args:
        partial: P in its file's frame and units.
    """
    found = [each.message for each in linear_values_of(partial) if each.is_sure]
    return tuple(f"{MARK}P's {message} (gscomplete validate)" for message in found)


def doubts_of_partial(partial: Splats, *, is_size_given: bool = False) -> tuple[str, ...]:
    """Return what makes P doubtful as a part of one object.

    Args:
        partial: P in the object frame.
        is_size_given: whether the user gave the complete object's size.
    """
    if len(partial) < FEWEST:
        count = len(partial)
        return (f"{MARK}P has {count} splats, too few to recognise an object (at least {FEWEST})",)
    if _breadth(partial) < _LEAST_BREADTH:
        return (f"{MARK}P's splats lie along a line, which tells nothing of an object's shape",)
    side = _largest_side(partial)
    if is_size_given and side > _MOST_OF_SIZE:
        return (
            f"{MARK}P's largest side is {side:.2f} of the complete object's size, which cannot be "
            "smaller than P (--object-size)",
        )
    if partial.typical_size > _LARGEST_SPLAT * side > 0:
        return (
            f"{MARK}P's splats are as large as P (typically {partial.typical_size / side:.2g} of "
            "its largest side): they form no surface (scales written without a logarithm?)",
        )
    pieces = [share for share in _shares_of_pieces(partial) if share > _LEAST_PIECE]
    if len(pieces) < 2:
        return ()
    shares = " and ".join(f"{share:.0%}" for share in pieces)
    return (
        f"{MARK}P is in pieces that are far apart ({shares} of its splats) and is completed as one "
        "object; if they are several objects, cut out each (splatcomplete-data crop)",
    )


def doubts_of_guess(hidden_share: float) -> tuple[str, ...]:
    """Return what indicates a wrong guess or a wrong input view, before any step is taken.

    Args:
        hidden_share: of P's pixels in the input view and beside it, those that the guess hides.
    """
    if hidden_share <= MOST_HIDDEN:
        return ()
    return (
        f"{MARK}the guess hides {hidden_share:.0%} of P from the input view, although P was seen "
        "from there: the view or the guess is wrong (--view, --mirror, --alternatives)",
    )


def doubts_of_result(partial: Splats, new: Splats, lost: float | None) -> tuple[str, ...]:
    """Return what makes the result doubtful.

    Args:
        partial: P.
        new: the new splats.
        lost: share of the new splats that bounds on E_color and E_depth removed or faded; None =
            there were no bounds.
    """
    found = []
    if lost is not None and lost > _MOST_LOST:
        found.append(
            f"{lost:.0%} of the new splats were removed or faded to keep P's appearance: the "
            "guess was in front of P (--view, --mirror)"
        )
    own = _largest_side(partial)
    together = _largest_side(partial, new)
    if own < _OPEN_SIDE and together - own < _LEAST_GROWTH * (1 - own):
        found.append(
            f"P seems open to one side, yet the result is hardly larger ({together:.2f} of the "
            f"guessed size, P {own:.2f}): if P is complete, use it as it is; if P is one half, "
            "give --mirror cut; else give the object's size (--object-size)"
        )
    return tuple(MARK + reason for reason in found)


def doubts_of_change(color: float, depth: float) -> tuple[str, ...]:
    """Return what makes the result doubtful by how much it changes P.

    Args:
        color: E_color over V.
        depth: E_depth over V.
    """
    if color <= _MOST_COLOR_CHANGE and depth <= _MOST_DEPTH_CHANGE:
        return ()
    return (
        f"{MARK}the new splats change P's appearance over V (E_color {color:.3g}, E_depth "
        f"{depth:.3g}): they cover P, or P is hardly visible (--preserve, --view)",
    )


def _breadth(partial: Splats) -> float:
    """Return the middles' second largest deviation along a main axis, over the largest.

    It is 1 where all are in one place.
    """
    variances = torch.linalg.eigvalsh(torch.cov(partial.means.double().T)).clamp_min(0)
    return float((variances[1] / variances[2]).sqrt()) if variances[2] > 0 else 1.0


def _shares_of_pieces(partial: Splats) -> list[float]:
    """Return the shares of P's splats in pieces that no filled cell joins, the largest first."""
    means = partial.means.double().numpy()
    low, sides = means.min(axis=0), np.ptp(means, axis=0)
    cell = max(float(sides.max()), 1e-12) / _CELLS_OF_PIECES
    places = ((means - low) / cell).astype(int).clip(0, _CELLS_OF_PIECES - 1)
    filled = np.zeros((_CELLS_OF_PIECES,) * 3)
    np.add.at(filled, tuple(places.T), 1.0 / len(means))
    pieces, count = label(filled > 0, np.ones((3, 3, 3)))
    return sorted(sum_labels(filled, pieces, range(1, count + 1)).tolist(), reverse=True)


def _largest_side(*parts: Splats) -> float:
    """Return the largest side of the box about the middles of splats."""
    means = torch.cat([part.means for part in parts])
    return float((means.amax(dim=0) - means.amin(dim=0)).max())
