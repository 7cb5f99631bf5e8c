"""What hard preservation did to the new splats, in numbers and in words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from gscomplete.splats import Splats

_VISIBLE_CHANGE = 0.01
"""Relative change of an opacity or scale from which the report counts it."""
_VISIBLE_MOVE = 0.001
"""Change of place, in object sizes, from which the report counts it."""


@dataclass(frozen=True, slots=True)
class CheckedErrors:
    """E_color and E_depth over the check views.

    With ``mask_from`` above 0 they cover only the pixels that are held to P's appearance, and are
    then lower than what the evaluation measures over all of P.
    """

    color: float
    depth: float
    views: int
    """How many views they are measured over: few if they are far below the bounds."""


@dataclass(frozen=True, slots=True)
class HardPreservationReport:
    """What was done to the new splats, and what came of it."""

    before: CheckedErrors
    after: CheckedErrors
    met: bool
    """Whether both errors over the check views are now below their bounds."""
    total: int
    """New splats before."""
    untouched: int
    """Splats that are bit for bit what they were."""
    faded: int
    """Kept splats with a lower opacity."""
    moved: int
    """Kept splats that moved by more than a thousandth of the object's size."""
    shrunk: int
    """Kept splats with a smaller scale."""
    dropped: dict[str, int]
    """Splats removed for each reason: ``faded_away`` (their opacity fell below
    ``bounds._PRUNE_OPACITY``) or ``in_the_way`` (the last resort)."""
    added: int
    """Backing splats behind P's surface, after the rows that were given."""
    rounds: int
    """Rounds of refitting."""
    fadings: int
    """Sweeps of fading and removing."""
    seconds: float
    mask_from: float = 0.0
    """P's alpha from which pixels were held to its appearance."""

    @property
    def lost(self) -> float:
        """Share of the splats that were removed or faded; 0 where there were none."""
        return (self.faded + sum(self.dropped.values())) / max(self.total, 1)

    @property
    def summary(self) -> str:
        """Describe what was done in one line."""
        before, after = self.before, self.after
        where = f", pixels where P's alpha is at least {self.mask_from:g}" if self.mask_from else ""
        text = (
            f"bounds on E_color and E_depth (over {after.views} check views{where}): "
            f"E_color {before.color:.6f} to {after.color:.6f}, E_depth "
            f"{before.depth:.6f} to {after.depth:.6f}; {self.untouched:,} of {self.total:,} new "
            f"splats untouched, {self.faded:,} faded, {self.moved:,} moved, {self.shrunk:,} shrunk"
        )
        if self.added:
            text += f", {self.added:,} added behind P's surface"
        for reason, count in self.dropped.items():
            text += f", {count:,} removed ({reason.replace('_', ' ')})"
        return text + ("" if self.met else "; THE BOUNDS ARE NOT MET")


def count_changes(before: Splats, after: Splats, kept: Tensor, cleared: Tensor) -> dict[str, Any]:
    """Count what became of the splats."""
    same = torch.ones_like(kept)
    for (_, old), (_, new) in zip(before.fields(), after.fields(), strict=True):
        same &= (old == new).reshape(len(kept), math.prod(old.shape[1:])).all(dim=1)
    faded = after.opacities < (1.0 - _VISIBLE_CHANGE) * before.opacities
    moved = (after.means - before.means).norm(dim=1) > _VISIBLE_MOVE
    shrunk = (after.scales < (1.0 - _VISIBLE_CHANGE) * before.scales).any(dim=1)
    dropped = {
        "faded_away": int((~kept & ~cleared).sum()),
        "in_the_way": int((~kept & cleared).sum()),
    }
    return {
        "total": len(kept),
        "untouched": int((same & kept).sum()),
        "faded": int((faded & kept).sum()),
        "moved": int((moved & kept).sum()),
        "shrunk": int((shrunk & kept).sum()),
        "dropped": {reason: count for reason, count in dropped.items() if count},
    }
