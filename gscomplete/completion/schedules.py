"""What happens at which step (paper section 3.3, "Optimization").

Steps count from 0 here; the paper's step 1 is step 0.
"""

from __future__ import annotations

from gscomplete.completion.settings import CompletionSettings
from gscomplete.util.randomness import generator_for, uniform


def timestep_at(settings: CompletionSettings, step: int) -> float:
    """Draw the diffusion time of a step: uniform within the stage that the step lies in.

    Args:
        settings: of the run.
        step: counted from 0.
    """
    progress = (step + 0.5) / settings.steps
    stages = settings.timesteps
    for stage in stages:
        if progress <= stage.until:
            break
    return uniform(generator_for(settings.seed, step, "timestep"), stage.low, stage.high)


def is_warmup(settings: CompletionSettings, step: int) -> bool:
    """Whether the preservation loss is unmasked at this step."""
    return step < settings.warmup_steps


def has_preservation(settings: CompletionSettings, step: int) -> bool:
    """Whether the preservation loss joins this step; every warm-up step has it."""
    if settings.preservation_weight == 0:
        return False
    return is_warmup(settings, step) or step % settings.preservation_every == (
        settings.preservation_every - 1
    )


def resolution_at(settings: CompletionSettings, step: int, full_px: int) -> int:
    """Return the side of the renders of a step; coarse at first if the settings say so."""
    return full_px // 2 if step < settings.coarse_until * settings.steps else full_px


def is_round_start(settings: CompletionSettings, step: int) -> bool:
    """Whether new targets are made before this step: ``rounds`` times, or at every one of fewer."""
    steps, rounds = settings.steps, settings.rounds
    return step == 0 or step * rounds // steps != (step - 1) * rounds // steps


def is_densify_step(settings: CompletionSettings, step: int) -> bool:
    """Whether splats are subdivided after this step."""
    within = step < settings.densify.until * settings.steps
    return within and step > 0 and step % settings.densify.every == 0


def is_prune_step(settings: CompletionSettings, step: int) -> bool:
    """Whether splats are pruned after this step."""
    return step > 0 and step % settings.densify.every == 0
