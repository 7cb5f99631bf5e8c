"""Draw what the denoiser generates from text alone: one four-view sample for each prompt.

``python -m recipes.train_embedded_prior.samples --out sheet.png`` takes a caption of every family
of procedural objects, ``--prompts "a mug" "a chair"`` these, ``--meshes PACK --nouns 60`` nouns of
the pack's captions, drawn at random. With ``--blind DIR`` every sample is a numbered picture there,
in random order, for somebody to name who has not seen ``key.json``.

Conventions
-----------
* Every sample starts from pure noise, without P. Each step's denoised views get fresh noise for the
  next step, because noise that is kept leaves patches of colour.
* Where the noun is that of a known shape, the denoiser is shown this shape without colours,
  unless ``--no-known-shapes`` is given.
* Nouns are those of five captions or more of the train split, words that name no thing left out.
* View consistency: splats are fitted to the four views, starting from a sphere; the PSNR of their
  renders against the views says how well one object explains all four. It says nothing about how
  the object looks.
"""

from __future__ import annotations

import dataclasses
import json
import logging
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from gscomplete.completion.losses import fit_loss, random_background
from gscomplete.completion.start import initial_splats
from gscomplete.errors import UserError
from gscomplete.evaluate.pictures import contact_sheet, save_image, to_image
from gscomplete.fitting.parameters import BoundedParameters, Bounds
from gscomplete.fitting.settings import LearningRates
from gscomplete.priors.base import FourViews
from gscomplete.priors.embedded.conditioning import EmbeddedConditioning, upright
from gscomplete.priors.embedded.prior import EmbeddedPrior
from gscomplete.priors.embedded.weights import packaged_weights
from gscomplete.render import render
from gscomplete.shape.bank.nouns import head_noun
from gscomplete.shape.bank.store import BANK_FILE, read_bank
from gscomplete.splats import Splats
from gscomplete.util.jsonio import write_json
from gscomplete.util.randomness import generator_for
from gscomplete.views import four_view_orbit, radius_to_fit
from recipes.entry_point import start
from recipes.train_embedded_prior.data.mesh_pack import read_manifest
from recipes.train_embedded_prior.procedural.objects import FAMILIES, make_object_of

_LOG = logging.getLogger(__name__)
_FIT_SPLATS = 3000
_FEWEST_OF_A_NOUN = 5
_NO_THING = frozenset(
    (
        *("gltf", "standing", "sitting", "handed", "straight", "flat", "chopped", "up", "cut"),
        *("base", "piece", "unit", "half", "slice", "stand", "holder", "pictureframe", "top"),
    )
)
"""Last words of captions that are no names of things, or parts of such."""
_BLIND_PX = 256


@dataclass(frozen=True, slots=True)
class Options:
    """What to sample."""

    out: Path
    """PNG for the sheet; numbers go beside it, as JSON."""
    weights: Path | None = None
    """Folder of weights; None = the package's own."""
    families: tuple[str, ...] = ()
    """Families; none = all."""
    prompts: tuple[str, ...] = ()
    """Prompts instead of families' captions."""
    meshes: Path | None = None
    """Pack of meshes that nouns are drawn from."""
    nouns: int = 0
    """Prompts of nouns of the pack, instead of families' captions."""
    known_shapes: bool = True
    """Whether the denoiser gets the known shape of a prompt's noun."""
    text_scale: float | None = None
    """Guidance scale of the prompt; None = the prior's own scale."""
    blind: Path | None = None
    """Folder for numbered pictures in random order and for the key to them (``key.json``)."""
    steps: int = 8
    """Denoising steps of a sample."""
    fitted: int = 12
    """Number of samples whose consistency is measured, evenly chosen; 0 = none."""
    fit_steps: int = 250
    """Optimiser steps of a fit."""
    seed: int = 0


def sample(prior: EmbeddedPrior, told: EmbeddedConditioning, options: Options) -> FourViews:
    """Imagine an object."""
    views = prior.views
    radius = radius_to_fit(sum(views.extent_range) / 2, views.fov_deg)
    cameras = four_view_orbit(
        30.0, 15.0, radius=radius, fov_deg=views.fov_deg, size_px=views.resolution_px
    )
    guidance = prior.default_guidance(sees_input=False)
    if options.text_scale is not None:
        guidance = dataclasses.replace(guidance, text_scale=options.text_scale)
    zeros = torch.zeros(4, views.resolution_px, views.resolution_px)
    color, alpha = zeros[..., None].expand(-1, -1, -1, 3), zeros
    for number, share in enumerate(np.linspace(1, 0, options.steps, endpoint=False)):
        color, alpha = prior.reconstruct(
            FourViews(color, alpha, zeros, cameras),
            share * (prior.num_timesteps - 1),
            told,
            generator_for(options.seed, number, told.prompt),
            guidance=guidance,
            num_steps=1,
        )
    return FourViews(color, alpha, zeros, cameras)


def told_of(prior: EmbeddedPrior, prompt: str, *, known_shapes: bool) -> EmbeddedConditioning:
    """Return a prompt as the prior is told it, with a known shape of its noun."""
    told = prior.condition(prompt)
    bank = packaged_weights() / BANK_FILE
    shape = read_bank(bank).plainest(prompt) if known_shapes else None
    return told if shape is None else upright(told, bank, shape)


def drawn_nouns(folder: Path, count: int, seed: int) -> list[str]:
    """Draw nouns of a pack's captions."""
    entries = [entry for entry in read_manifest(folder) if entry.split == "train"]
    found = Counter(head_noun(f"a {entry.noun}") for entry in entries)
    frequent = [n for n, k in found.items() if n and k >= _FEWEST_OF_A_NOUN and n not in _NO_THING]
    picked = np.random.default_rng(seed).permutation(len(frequent))[:count]
    return [sorted(frequent)[k] for k in picked]


def prompts_of(options: Options) -> dict[str, str]:
    """Return the prompts by their labels."""
    if options.prompts:
        return {prompt: prompt for prompt in options.prompts}
    if options.nouns:
        if options.meshes is None:
            raise UserError("--nouns: expected --meshes PACK to draw them from")
        nouns = drawn_nouns(options.meshes, options.nouns, options.seed)
        return {noun: f"an {noun}" if noun[0] in "aeiou" else f"a {noun}" for noun in nouns}
    families = options.families or tuple(FAMILIES)
    made = (make_object_of(family, options.seed, k) for k, family in enumerate(families))
    return {family: item.caption for family, item in zip(families, made, strict=True)}


def save_blind(folder: Path, rows: dict[str, list[Image.Image]], seed: int) -> None:
    """Write numbered pictures in random order, and which is which."""
    folder.mkdir(parents=True, exist_ok=True)
    order = np.random.default_rng((seed, 1)).permutation(len(rows))
    labels = list(rows)
    for number, k in enumerate(order):
        large = [image.resize((_BLIND_PX, _BLIND_PX), Image.Resampling.BICUBIC)
                 for image in rows[labels[k]]]  # fmt: skip
        save_image(contact_sheet([large]), folder / f"{number:02d}.png")
    write_json(folder / "key.json", {f"{n:02d}": labels[k] for n, k in enumerate(order)})


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
    prompts = prompts_of(options)
    fitted = set(np.linspace(0, len(prompts) - 1, max(options.fitted, 1)).astype(int).tolist())
    rows: dict[str, list[Image.Image]] = {}
    found = {}
    for number, (label, prompt) in enumerate(prompts.items()):
        told = told_of(prior, prompt, known_shapes=options.known_shapes)
        views = sample(prior, told, options)
        rows[label] = [to_image(image) for image in _over_grey(views.color, views.alpha)]
        if options.fitted and number in fitted:
            found[label] = consistency_db(views, options.fit_steps, options.seed)
            _LOG.info("%-20s %-50s %.1f dB", label, prompt, found[label])
    title = "from words and known shapes" if options.known_shapes else "from words alone"
    sheet = contact_sheet(list(rows.values()), row_labels=list(rows), title=title)
    save_image(sheet, options.out)
    if options.blind is not None:
        save_blind(options.blind, rows, options.seed)
    mean = float(np.mean(list(found.values()))) if found else None
    summary = {"consistency_db": found, "mean_db": mean}
    options.out.with_suffix(".json").write_text(json.dumps(summary, indent=1) + "\n")
    if mean is not None:
        _LOG.info("mean consistency %.1f dB over %d samples", mean, len(found))
    return 0


if __name__ == "__main__":
    start(main, Options, __doc__)
