"""A completion's steps from a given V, without a file frame: what loops are tested on."""

import torch

from gscomplete.completion.optimise import Optimisation
from gscomplete.completion.settings import CompletionSettings
from gscomplete.completion.start import start_splats
from gscomplete.priors.base import Prior
from gscomplete.splats import Splats
from gscomplete.views import ViewDistribution


def steps_of(
    partial: Splats,
    prior: Prior,
    conditioning,
    views: ViewDistribution,
    settings: CompletionSettings,
    device: torch.device | str = "cpu",
) -> Optimisation:
    """Start as the pipeline does, with a sphere of diameter 1."""
    start = start_splats(partial, prior, conditioning, views, settings)
    return Optimisation(partial, start.splats, prior, conditioning, views, settings, device)
