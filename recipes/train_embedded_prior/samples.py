"""Look at what the denoiser imagines from words alone: one four-view sample for each family.

``python -m recipes.train_embedded_prior.samples --out sheet.png``

Conventions
-----------
* Every sample starts from pure noise, without P, from the caption of one object of the family.
* View consistency: splats are fitted to the four views, starting from a sphere; the PSNR of their
  renders against the views says how well one object explains all four. It says nothing about how
  the object looks.
"""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from gscomplete.completion.losses import fit_loss, random_background
from gscomplete.completion.start import initial_splats
from gscomplete.evaluate.pictures import contact_sheet, save_image, to_image
from gscomplete.fitting.parameters import BoundedParameters, Bounds
from gscomplete.fitting.settings import LearningRates
from gscomplete.priors.base import FourViews
from gscomplete.priors.embedded.prior import EmbeddedPrior, packaged_weights
from gscomplete.render import render
from gscomplete.splats import Splats
from gscomplete.util.randomness import generator_for
from gscomplete.views import four_view_orbit, radius_to_fit
from recipes.entry_point import start
from recipes.train_embedded_prior.procedural.objects import FAMILIES, make_object_of

_LOG = logging.getLogger(__name__)
_FIT_SPLATS = 3000


@dataclass(frozen=True, slots=True)
class Options:
    """What to sample."""

    out: Path
    """PNG for the sheet; numbers go beside it, as JSON."""
    weights: Path | None = None
    """Folder of weights; None = the package's own."""
    families: tuple[str, ...] = ()
    """Families; none = all."""
    steps: int = 16
    """Denoising steps of a sample."""
    fitted: int = 12
    """Samples whose consistency is measured, evenly chosen; 0 = none."""
    fit_steps: int = 250
    """Optimiser steps of a fit."""
    seed: int = 0


def sample(prior: EmbeddedPrior, caption: str, steps: int, seed: int) -> FourViews:
    """Imagine an object from its caption."""
    views = prior.views
    radius = radius_to_fit(sum(views.extent_range) / 2, views.fov_deg)
    cameras = four_view_orbit(
        30.0, 15.0, radius=radius, fov_deg=views.fov_deg, size_px=views.resolution_px
    )
    size = (4, views.resolution_px, views.resolution_px)
    blank = FourViews(torch.zeros(*size, 3), torch.zeros(size), torch.zeros(size), cameras)
    color, alpha = prior.reconstruct(
        blank,
        prior.num_timesteps - 1.0,
        prior.condition(caption),
        generator_for(seed, 0, caption),
        num_steps=steps,
    )
    return FourViews(color, alpha, torch.zeros(size), cameras)


def consistency_db(views: FourViews, steps: int, seed: int) -> float:
    """Fit splats to four views and return the PSNR of their renders over mid grey."""
    mean = (views.color.sum(dim=(0, 1, 2)) / views.alpha.sum().clamp_min(1.0)).clamp(0, 1)
    colored = Splats(
        torch.zeros(1, 3),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        torch.ones(1, 3),
        torch.ones(1),
        ((mean - 0.5) / 0.28209479177387814)[None, None],
    )
    start = initial_splats(colored, _FIT_SPLATS, 0.9, seed, min_scale=0.008, max_scale=0.1)
    rates = LearningRates(means=4e-3, means_final=4e-4, sh=2e-2, log_scales=1e-2)
    parameters = BoundedParameters(start, rates, Bounds(0.006, 0.1))
    for step in range(steps):
        background = random_background(generator_for(seed, step, "background"))
        drawn = render(parameters.splats(), views.cameras)
        fit_loss(drawn, views.color, views.alpha, background).backward()
        parameters.step(step / steps)
    with torch.no_grad():
        drawn = render(parameters.splats(), views.cameras)
    error = _over_grey(drawn.color, drawn.alpha) - _over_grey(views.color, views.alpha)
    return float(-10 * torch.log10(error.square().mean()))


def _over_grey(color: Tensor, alpha: Tensor) -> Tensor:  # [4, H, W, 3]
    return color + 0.5 * (1 - alpha)[..., None]


def main(options: Options) -> int:
    """Run from the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    prior = EmbeddedPrior.from_folder(options.weights or packaged_weights())
    families = options.families or tuple(FAMILIES)
    fitted = set(np.linspace(0, len(families) - 1, max(options.fitted, 1)).astype(int).tolist())
    rows: list[list[Image.Image]] = []
    labels, found = [], {}
    for number, family in enumerate(families):
        caption = make_object_of(family, options.seed, number).caption
        views = sample(prior, caption, options.steps, options.seed)
        rows.append([to_image(image) for image in _over_grey(views.color, views.alpha)])
        labels.append(family)
        if options.fitted and number in fitted:
            found[family] = consistency_db(views, options.fit_steps, options.seed)
            _LOG.info("%-20s %-50s %.1f dB", family, caption, found[family])
    save_image(contact_sheet(rows, row_labels=labels, title="from words alone"), options.out)
    summary = {"consistency_db": found, "mean_db": float(np.mean(list(found.values())))}
    options.out.with_suffix(".json").write_text(json.dumps(summary, indent=1) + "\n")
    _LOG.info("mean consistency %.1f dB over %d samples", summary["mean_db"], len(found))
    return 0


if __name__ == "__main__":
    start(main, Options, __doc__)
