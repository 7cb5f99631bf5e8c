"""The settings that are compared on priors of known strength, by name."""

from __future__ import annotations

import dataclasses

from gscomplete.completion.presets import DISTILL, LATENT, PAPER
from gscomplete.completion.settings import CompletionSettings, TimestepStage

_NEVER = 10**9
"""Steps between preservation losses that are never taken; the warm-up keeps its own."""

TABLE_2 = ("bare", "no-loss", "no-schedule", "paper")
"""Rows of the paper's Table 2: without loss, schedule and warm-up; without loss; without schedule;
all of it."""

WAYS: dict[str, CompletionSettings] = {
    "bare": PAPER.ablated(),
    "no-loss": dataclasses.replace(PAPER, preservation_every=_NEVER),
    "no-schedule": dataclasses.replace(PAPER, timesteps=(TimestepStage(1.0, 20.0, 980.0),)),
    "paper": PAPER,
    "distill": DISTILL,
    "stages": dataclasses.replace(DISTILL, timesteps=PAPER.timesteps),
    "latent": LATENT,
    "fine": dataclasses.replace(LATENT, coarse_until=0.0),
}
"""``stages``: ``distill`` with the paper's timesteps. ``fine``: ``latent`` at full resolution."""
