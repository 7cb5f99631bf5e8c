"""The plane of symmetry that P is mirrored through, as users choose it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from gscomplete.errors import UserError


@dataclass(frozen=True, slots=True)
class MirrorPlane:
    """An upright plane of symmetry in the object frame."""

    azimuth_deg: float
    """Of its normal, as of views: 0 = +x, 90 = +y."""
    offset: float
    """How far along its normal it is from the frame's centre, in object sizes."""

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            UserError: a value makes no sense.
        """
        for name in ("azimuth_deg", "offset"):
            if not math.isfinite(getattr(self, name)):
                raise UserError(f"mirror: {name}: expected a finite number")
        if not abs(self.offset) <= 1:
            raise UserError(f"mirror: offset: expected -1 to 1 object sizes, found {self.offset:g}")

    def __str__(self) -> str:
        """Return the plane as users write it."""
        # Adding 0 turns a negative zero into 0.
        return f"{round(self.azimuth_deg, 1) + 0.0:.1f},{round(self.offset, 3) + 0.0:.3f}"


Mirror = Literal["guess", "none"] | MirrorPlane
"""Which plane P is mirrored through: the prior's guess, none, or this one."""


ChosenMirror = Literal["none"] | MirrorPlane
"""What users may choose instead of the guess."""
