"""The settings that are compared on priors of known strength, by name."""

from __future__ import annotations

import dataclasses

from gscomplete.completion.presets import DISTILL, PAPER
from gscomplete.completion.settings import CompletionSettings, TimestepStage

_change = dataclasses.replace


def annealed(high: float, low: float, width: float, stages: int = 20) -> tuple[TimestepStage, ...]:
    """Return timesteps that fall evenly, each drawn from a band about the line.

    Args:
        high: middle of the first band.
        low: middle of the last band.
        width: half a band.
        stages: in how many steps the line falls.
    """
    found = []
    for k in range(stages):
        middle = high + (low - high) * k / (stages - 1)
        found.append(TimestepStage((k + 1) / stages, max(middle - width, 2.0), min(middle + width, 998.0)))
    return tuple(found)


NEVER = 10**9
"""Steps between preservation losses that are never taken; the warm-up keeps its own."""

WAYS: dict[str, CompletionSettings] = {
    "paper": PAPER,
    "no-schedule": _change(PAPER, timesteps=(TimestepStage(1.0, 20.0, 980.0),)),
    "no-loss": _change(PAPER, preservation_every=NEVER),
    "bare": PAPER.ablated(),
    "distill": DISTILL,
    "annealed": _change(DISTILL, timesteps=annealed(900.0, 50.0, 50.0)),
}
"""The first four are the rows of the paper's Table 2, from the last to the first."""
