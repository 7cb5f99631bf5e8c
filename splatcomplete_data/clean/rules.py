"""The rules of ``clean``, each of which marks splats to be removed.

* ``floaters``, ``giants``, ``haze``, ``needles``: as in ``gscomplete.splats.suspects``.
* ``islands``: small clusters that touch nothing else.
* ``background``: planes that bear the object (table, floor, wall) and everything behind them, as
  ``propose_box`` finds them; only on request.

Conventions
-----------
* A rule gives a mask of its own; a splat is counted under the first rule that marks it. Nothing is
  changed here.
* Strength 0 marks only what cannot be drawn; 0.5 has the limits at which ``validate`` warns; 1 has
  the strictest limits that still spare evenly covered surfaces. In between limits are interpolated
  geometrically.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from gscomplete.errors import UserError
from gscomplete.splats import Splats, usable_rows
from gscomplete.splats.filters import FAR_FACTOR, far_positions, in_words, middle_and_extent
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.splats.suspects import FEWEST, SuspectLimits, suspect_rows
from gscomplete.util.arrays import BoolArray, Float64Array, IntArray
from splatcomplete_data.multiview.propose_box import Focus, propose_box, shown_area
from splatcomplete_data.scan.clusters import cluster

Rule = Literal["floaters", "giants", "haze", "needles", "islands", "background"]
DEFAULT_RULES: tuple[Rule, ...] = ("floaters", "giants", "haze", "needles", "islands")

_GENTLE = SuspectLimits(10.0, 1.0, 0.2, 0.03, 0.2, 30.0)
_STRICT = SuspectLimits(2.6, 0.1, 0.02, 0.25, 0.02, 6.0)
_ISLAND_SHARES = (3e-4, 3e-3, 3e-2)
"""Largest share of all that an island holds, at strengths 0, 0.5 and 1."""
_ISLAND_GAP = 0.03
"""Least distance of an island from everything else, share of the extent."""
_REACH_SIGMAS = 1.5
"""Splats touch each other within this many of their standard deviations."""


@dataclass(frozen=True, slots=True)
class Cleaned:
    """What stays, and why the rest goes."""

    keep: BoolArray  # [N]
    reasons: dict[str, int]
    """Splats by the first rule that marks them; rules that mark none are left out."""
    notes: tuple[str, ...] = ()


def limits_at(strength: float) -> SuspectLimits:
    """Return the limits of a strength.

    Args:
        strength: above 0, at most 1.
    """
    names = SuspectLimits.__dataclass_fields__
    triples = {
        name: tuple(getattr(limits, name) for limits in (_GENTLE, SuspectLimits(), _STRICT))
        for name in names
    }
    return SuspectLimits(**{name: _between(triple, strength) for name, triple in triples.items()})


def clean_rows(
    splats: Splats,
    strength: float,
    rules: Sequence[Rule] = DEFAULT_RULES,
    focus: Focus | None = None,
    option: str = "--strength",
) -> Cleaned:
    """Mark the splats that remain after the rules are applied.

    Args:
        splats: N splats in any frame, those that cannot be drawn among them.
        strength: 0 to 1.
        rules: which ones apply.
        focus: where the object is, for ``background``.
        option: that the user gave the strength by, for errors.

    Raises:
        UserError: the strength is out of range, ``background`` lacks a focus, or nothing is left.
    """
    if not 0 <= strength <= 1:
        raise UserError(f"{option}: expected 0 to 1, found {strength:g}")
    usable, reasons = usable_rows(splats)
    keep = usable.numpy().copy()
    drawn = splats.select(usable)
    notes: list[str] = []
    if strength > 0 and len(drawn):
        gone = np.zeros(len(drawn), np.bool_)
        for rule, mask in _marks(drawn, strength, rules, focus, notes):
            count = int((mask & ~gone).sum())
            if count:
                reasons = {**reasons, rule: count}
            gone |= mask
        keep[keep] = ~gone
    if not keep.any():
        raise UserError(
            f"clean: nothing is left of {len(splats):,} splats: {in_words(dict(reasons))}"
        )
    return Cleaned(keep, dict(reasons), tuple(notes))


def _marks(
    drawn: Splats,
    strength: float,
    rules: Sequence[Rule],
    focus: Focus | None,
    notes: list[str],
) -> list[tuple[Rule, BoolArray]]:  # [N] each
    """Return what each rule marks, in the order of the rules' description."""
    suspects = suspect_rows(drawn, limits_at(strength))
    marks: list[tuple[Rule, BoolArray]] = [
        (name, mask.numpy()) for name, mask in suspects.items() if name in rules
    ]
    gone = np.any([mask for _, mask in marks], axis=0) if marks else np.zeros(len(drawn), bool)
    if "background" in rules:
        if focus is None:
            raise UserError("--background: expected to know where the object is")
        behind = _background(drawn.select(torch.from_numpy(~gone)), focus, notes)
        mask = np.zeros(len(drawn), np.bool_)
        mask[~gone] = behind
        marks.append(("background", mask))
        gone = gone | mask
    if "islands" in rules:  # last, because the other rules may leave islands behind
        mask = np.zeros(len(drawn), np.bool_)
        if (~gone).any():
            mask[~gone] = islands(drawn.select(torch.from_numpy(~gone)), strength)
        marks.append(("islands", mask))
    return marks


def islands(splats: Splats, strength: float) -> BoolArray:  # [N]
    """Mark splats of clusters that hold little and touch nothing else, and those far off.

    Args:
        splats: drawable.
        strength: above 0, at most 1.
    """
    if len(splats) < FEWEST:
        return np.zeros(len(splats), np.bool_)
    middle, extent = middle_and_extent(splats.means.numpy())
    if not extent > 0:
        return np.zeros(len(splats), np.bool_)
    places, owners = _reach(splats)
    labels = cluster((places - middle) / extent, _ISLAND_GAP)
    count = int(labels.max()) + 1
    links = coo_matrix((np.ones(len(owners)), (owners, len(splats) + labels)))
    links.resize(len(splats) + count, len(splats) + count)
    _, component = connected_components(links, directed=False)
    own = component[: len(splats)]
    weight = shown_area(splats) + 1e-30
    held = np.bincount(own, weight)
    share = _between(_ISLAND_SHARES, strength)
    far = far_positions(splats.means.numpy(), middle, extent, FAR_FACTOR)
    return np.asarray(far | (held[own] < share * weight.sum()))


def _reach(splats: Splats) -> tuple[Float64Array, IntArray]:  # [5 N, 3], [5 N]
    """Return the points that splats reach (centres, ends of long axes) and the splat of each."""
    order = splats.scales.argsort(dim=1, descending=True)[:, :2]
    axes = rotation_matrices(splats.quaternions).transpose(1, 2)
    along = axes.gather(1, order[:, :, None].expand(-1, -1, 3))
    along = _REACH_SIGMAS * along * splats.scales.gather(1, order)[:, :, None]
    ends = torch.cat([along, -along], dim=1)
    places = torch.cat([splats.means[:, None], splats.means[:, None] + ends], dim=1).double()
    owners = np.repeat(np.arange(len(splats)), places.shape[1])
    return places.reshape(-1, 3).numpy(), owners


def _background(splats: Splats, focus: Focus, notes: list[str]) -> BoolArray:  # [N]
    """Mark what lies in or behind the planes that bear the object."""
    none = np.zeros(len(splats), np.bool_)
    try:
        proposal = propose_box(splats, focus)
    except UserError as error:
        notes.append(f"background: kept ({error})")
        return none
    if not proposal.planes:
        notes.append("background: kept, as no plane was found that the object stands on")
        return none
    notes.append(f"background: {len(proposal.planes)} planes found")
    points = splats.means.double().numpy()
    return ~np.all([plane.before(points) for plane in proposal.planes], axis=0)


def _between(triple: Sequence[float], strength: float) -> float:
    """Return the value at a strength, given those at 0, 0.5 and 1."""
    return math.exp(float(np.interp(strength, (0.0, 0.5, 1.0), np.log(triple))))
