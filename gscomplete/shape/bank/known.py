"""Access to the known shapes that a prompt names, fitted to P, and what users are told of them."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gscomplete.shape.bank.as_answer import DECIDING
from gscomplete.shape.bank.fit import FitLimits, FittedShape, fit_known_shapes
from gscomplete.shape.bank.nouns import head_noun
from gscomplete.shape.bank.store import read_bank
from gscomplete.splats import Splats
from gscomplete.util.stages import stage
from gscomplete.views import ViewDistribution

MOST_SHOWN = 3
"""Known shapes that the network is shown."""


@dataclass(frozen=True, slots=True)
class KnownShapes:
    """Access to the known shapes that the prompt names."""

    bank: Path | None
    """File of the bank; None = no shape is known."""
    prompt: str
    """Text whose noun names the shapes."""
    decide: bool = False
    """Whether the shape that suits P best is taken in place of the network's answer."""

    def fitted(self, partial: Splats, views: ViewDistribution) -> tuple[FittedShape, ...]:
        """Return the shapes that suit P, fitted to it, the best first."""
        if self.bank is None:
            return ()
        points, toward_c = partial.means.double().numpy().tobytes(), views.direction().tobytes()
        limits = DECIDING if self.decide else FitLimits()
        return _fitted(self.bank, self.prompt, points, toward_c, limits)

    def may_agree(self) -> bool:
        """Return whether two packs have shapes of that name; at most one per pack is fitted."""
        if self.bank is None:
            return False
        bank = read_bank(self.bank)
        return len({bank.names[k].pack for k in bank.named(self.prompt, len(bank))}) > 1

    def notes(self, used: tuple[FittedShape, ...]) -> tuple[str, ...]:
        """Say which shapes were used, or why none were."""
        noun = head_noun(self.prompt)
        if self.bank is None or noun is None:
            return ()
        names = ", ".join(shape.name.id for shape in used)
        if used and self.decide:
            return (f"{noun}: P becomes the known shape that fits it best, {names}",)
        if used:
            return (f"{noun}: known shapes used: {names} (--no-known-shapes leaves them out)",)
        if read_bank(self.bank).named(self.prompt, 1):
            if self.decide:
                return (f"{noun}: no known shape fits P, so P is completed without one",)
            return (f"{noun}: known shapes not used: they do not fit P, disagree, or add nothing",)
        return (f"{noun}: no known shape has this name",)

    def contradiction(self, shapes: tuple[FittedShape, ...], count: int) -> str:
        """Say how many mirrored splats were left out because known shapes contradict them."""
        names = ", ".join(shape.name.id for shape in shapes)
        left_out = f"{count:,} mirrored splats left out, as no known shape has them ({names})"
        return f"{head_noun(self.prompt)}: {left_out} (--no-known-shapes keeps them)"


@functools.lru_cache(maxsize=1)
def _fitted(
    bank: Path, prompt: str, points: bytes, toward_c: bytes, limits: FitLimits
) -> tuple[FittedShape, ...]:
    """Fit shapes once for all guesses about one part."""
    places, direction = np.frombuffer(points).reshape(-1, 3), np.frombuffer(toward_c)
    with stage("known shapes"):
        found = fit_known_shapes(read_bank(bank), prompt, places, direction, MOST_SHOWN, limits)
    return tuple(found)
