"""Whole completions without a run folder: what benchmarks and comparisons time and measure."""

from __future__ import annotations

import time
from dataclasses import dataclass

from gscomplete.completion.finish import finish_splats
from gscomplete.completion.optimise import Completion
from gscomplete.completion.settings import CompletionSettings
from gscomplete.priors.base import Prior
from gscomplete.splats import Splats
from gscomplete.views import ViewDistribution


@dataclass(frozen=True, slots=True)
class Answer:
    """What one way to complete adds to a part."""

    splats: Splats
    """New splats."""
    views: ViewDistribution
    """V: from its views P keeps its looks."""
    seconds: float


def completed(
    partial: Splats,
    prompt: str,
    prior: Prior,
    guessed: ViewDistribution,
    settings: CompletionSettings,
) -> Answer:
    """Complete a part as a run does whose user gave no input view.

    Args:
        partial: P in the object frame.
        prompt: what it is.
        prior: the model that guides.
        guessed: V as guessed from P.
        settings: of the run.
    """
    started = time.perf_counter()
    conditioning = prior.condition(prompt)
    run = Completion(partial, prior, conditioning, guessed, settings, view_is_guess=True)
    while not run.finished:
        run.step()
    finished = finish_splats(run.new_splats(), partial, run.distribution, settings)
    return Answer(finished.splats, run.distribution, time.perf_counter() - started)
