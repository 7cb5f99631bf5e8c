"""Named settings: the paper's, and those that were chosen for small priors.

Conventions
-----------
* ``PAPER`` has exactly the paper's settings; every other preset lists only what differs from the
  one it is derived from. One difference is not a setting: here the sphere of the start is centred
  on the origin of the object frame, the guessed centre of the complete object; in the paper
  (section 3.3) it is centred on P's box. ``docs/mvdream.md`` lists what the paper leaves open.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

from gscomplete.completion.settings import (
    CompletionSettings,
    HardPreservationSettings,
    TimestepStage,
    annealed_timesteps,
)
from gscomplete.errors import UserError
from gscomplete.fitting.settings import DensifySettings, LearningRates
from gscomplete.priors.base import Prior

PresetName = Literal["default", "fast", "reconstruct", "distill", "paper"]
"""``default``: the best compromise of time and quality for the prior. ``fast``: less care.
``reconstruct``: iterative reconstruction. ``distill``: score distillation, from the prior's guess
where it has one, in as many steps as the prior needs. ``paper``: the paper's settings. The prior
says which of ``SETTINGS`` each of them stands for (``preset``)."""

PAPER = CompletionSettings()
"""The paper's settings (sections 3.1 to 3.3); where the sphere stands: see above."""

DISTILL = dataclasses.replace(
    PAPER,
    steps=600,
    timesteps=annealed_timesteps(950.0, 150.0, 40.0),
    min_scale_px=0.5,
    max_scale=0.1,
    learning_rates=LearningRates(means=4e-3, means_final=4e-4, sh=2e-2, log_scales=1e-2),
    densify=DensifySettings(every=25, growth=0.2, max_new=20_000, split_scale=0.03, final_from=0.8),
    leave_out_strays=True,
    close_slits=True,
    checkpoint_every=100,
)
"""The paper's method in fewer and larger steps, with scales of at least a pixel. Noise falls from
nearly full to little: with a prior that keeps what it sees, the paper's first stage, of medium
noise, would keep the initial sphere as fog."""

LATENT = dataclasses.replace(
    DISTILL, steps=2000, coarse_until=0.5, rescale_about="background", checkpoint_every=500
)
"""For priors that see only colours over black or white. Chosen on priors of known strength
(``recipes.known_priors``): guidance rescale about zero fills empty space with fog, and steps at
half the resolution find the shape in half as many steps."""

RECONSTRUCT = dataclasses.replace(
    DISTILL,
    mode="reconstruct",
    steps=240,
    new_splats=10_000,
    min_scale_px=0.1,
    rounds=8,
    denoise_steps=2,
    ring_memory=5,
    start="guess",
    preservation_every=1,
    preservation_views=32,
    timesteps=(
        TimestepStage(0.5, 200.0, 350.0),
        TimestepStage(1.0, 50.0, 150.0),
    ),
    learning_rates=LearningRates(
        means=5e-4,
        means_final=1e-4,
        quaternions=2e-3,
        log_scales=3e-3,
        opacity_logits=2e-2,
        sh=5e-3,
    ),
    checkpoint_every=80,
)
"""Iterative reconstruction: a few denoised rings, many cheap fitting steps."""

GUESS = dataclasses.replace(
    RECONSTRUCT,
    steps=0,
    new_splats=20_000,
    hard_preservation=HardPreservationSettings(color_bound=8e-4, depth_bound=2e-3, mask_from=0.8),
)
"""The first guess of a prior with a shape network, held to P's appearance where P is dense. No
steps follow: those of a small denoiser do not improve the shape and make colours dirtier (the
time/quality benchmark)."""

REFINE = dataclasses.replace(
    GUESS,
    mode="distill",
    moves="colors",
    steps=24,
    least_color_spread=0.05,
    prior_every=3,
    timesteps=annealed_timesteps(600.0, 150.0, 50.0),
    learning_rates=LearningRates(sh=1e-2),
)
"""Score distillation of colours alone, from the first guess, if P has several colours: patterns
continue and the shape stays. All steps are within the warm-up. They gain less with a masked loss
from the start, with more steps or noise, or when shapes move too
(docs/decisions/distillation.md)."""

FILL = dataclasses.replace(GUESS, start="fill", hard_preservation=None)
"""P's gaps are closed and nothing else is done. There are no bounds on P's appearance, because what
is seen through a gap is meant to change."""

UNBOUNDED_GUESS = dataclasses.replace(GUESS, hard_preservation=None)
"""The first guess as it is."""

TEXT_ONLY = dataclasses.replace(
    DISTILL,
    mode="reconstruct",
    see_input=False,
    steps=480,
    new_splats=8000,
    rounds=16,
    denoise_steps=2,
    ring_memory=5,
    preservation_every=1,
    preservation_views=32,
    timesteps=(
        TimestepStage(0.4, 960.0, 999.0),
        TimestepStage(0.7, 700.0, 850.0),
        TimestepStage(1.0, 250.0, 500.0),
    ),
    learning_rates=LearningRates(means=2e-3, means_final=2e-4, sh=5e-3, log_scales=1e-2),
    checkpoint_every=80,
)
"""Iterative reconstruction with P withheld from the prior, or for priors that cannot see it: from
a sphere, from nearly pure noise."""


SETTINGS: dict[str, CompletionSettings] = {
    "paper": PAPER,
    "distill": DISTILL,
    "latent": LATENT,
    "refine": REFINE,
    "reconstruct": RECONSTRUCT,
    "guess": GUESS,
    "unbounded guess": UNBOUNDED_GUESS,
    "text only": TEXT_ONLY,
}
"""What a prior's ``presets`` may name."""

ANY_PRIOR: dict[PresetName, str] = {
    "default": "paper",
    "fast": "text only",
    "reconstruct": "text only",
    "distill": "paper",
    "paper": "paper",
}
"""Presets of priors that name none."""


def preset(name: PresetName, prior: Prior, *, text_only: bool = False) -> CompletionSettings:
    """Return the settings that a prior names for a preset.

    Args:
        name: of the preset.
        prior: the model that guides; its attribute ``presets``, where it has one, says which of
            ``SETTINGS`` a preset stands for (``ANY_PRIOR`` for others).
        text_only: withhold P from the prior.

    Raises:
        UserError: there are no such preset or settings, or a name was given for the prior itself.
    """
    if isinstance(prior, str):
        raise UserError(f"preset: expected a prior (load_prior), found the text {prior!r}")
    table = getattr(prior, "presets", ANY_PRIOR)
    if name not in table:
        raise UserError(f"preset: expected one of {', '.join(table)}, found {name!r}")
    if table[name] not in SETTINGS:
        raise UserError(
            f"presets of the prior {prior.name}: {name}: expected one of {', '.join(SETTINGS)}, "
            f"found {table[name]!r}"
        )
    chosen = SETTINGS[table[name]]
    if not text_only:
        return chosen
    if chosen.start == "guess":
        chosen = DISTILL if chosen.mode == "distill" else TEXT_ONLY
    return dataclasses.replace(chosen, see_input=False)
