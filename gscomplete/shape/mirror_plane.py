"""What P is mirrored through, as users choose it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from gscomplete.errors import UserError

_LARGEST_DEG = 1e6
"""Of larger azimuths float32 keeps no tenth of a degree; views have the same limit."""


def _require_azimuth(name: str, azimuth_deg: float) -> None:
    if not abs(azimuth_deg) <= _LARGEST_DEG:
        raise UserError(
            f"mirror: {name}: expected an azimuth of -1e6 to 1e6 degrees, found {azimuth_deg:g}"
        )


@dataclass(frozen=True, slots=True)
class MirrorPlane:
    """An upright plane of symmetry in the object frame."""

    azimuth_deg: float
    """Azimuth of its normal, counted as for views: 0 = +x, 90 = +y."""
    offset: float
    """How far along its normal it is from the frame's centre, in object sizes."""

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            UserError: a value makes no sense.
        """
        _require_azimuth("azimuth_deg", self.azimuth_deg)
        if not abs(self.offset) <= 1:
            raise UserError(f"mirror: offset: expected -1 to 1 object sizes, found {self.offset:g}")

    def __str__(self) -> str:
        """Return the plane as users write it."""
        # Adding 0 turns a negative zero into 0.
        return f"{round(self.azimuth_deg, 1) + 0.0:.1f},{round(self.offset, 3) + 0.0:.3f}"


@dataclass(frozen=True, slots=True)
class HalfCut:
    """P is one half of the object, whose other half is P mirrored through the plane P ends at."""

    toward_deg: float | None = None
    """Rough azimuth of the other half, degrees; None = it is found (``framing.end_plane``)."""

    def __post_init__(self) -> None:
        """Check the azimuth.

        Raises:
            UserError: it makes no sense.
        """
        if self.toward_deg is not None:
            _require_azimuth("cut", self.toward_deg)

    def __str__(self) -> str:
        """Return it as users write it."""
        return "cut" if self.toward_deg is None else f"cut:{self.toward_deg:g}"


Mirror = Literal["guess", "none"] | MirrorPlane
"""Which plane P is mirrored through: the prior's guess, none, or this one."""

ChosenMirror = Literal["none"] | HalfCut | MirrorPlane
"""What users may choose instead of the guess."""

MirrorWish = Literal["guess"] | ChosenMirror
"""What users may ask for."""
