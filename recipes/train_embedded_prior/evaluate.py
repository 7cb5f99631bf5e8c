"""Measure a denoiser on objects it never saw, and draw what it imagines.

``python -m recipes.train_embedded_prior.evaluate --weights DIR --out sheet.png``

Conventions
-----------
* Held-out losses are the plain mean squared error of v, by timestep, seeing P, the object's
  shape or neither, always with text. Noise is fixed, so that numbers of different steps and runs
  compare.
* On a sheet every set has five rows of four views: the truth, P as seen, a sample given P and
  text, one given the shape and text, one given text alone; all over mid grey.
"""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import tyro
from PIL import Image
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.priors.ddim import ddim, even_times
from gscomplete.priors.embedded.diffusion import (
    NUM_TIMESTEPS,
    add_noise,
    guided_x0,
    scales_like,
    velocity,
    x0_from_v,
)
from gscomplete.priors.embedded.inputs import images_to_color_alpha
from gscomplete.priors.embedded.model import FourViewDenoiser
from gscomplete.priors.embedded.text import no_text_like
from gscomplete.priors.embedded.weights import load_weights, packaged_weights
from gscomplete.util.atomic import atomic_path
from recipes.train_embedded_prior.config import DataConfig
from recipes.train_embedded_prior.data.dataset import HELD_OUT_SEED_OFFSET, Batch, decode_sets
from recipes.train_embedded_prior.data.shards import ShardSpec

_LOG = logging.getLogger(__name__)

LOSS_TIMESTEPS = (100, 300, 500, 700, 900)
_SHEET_SETS = 4
_SHEET_STEPS = 16
_CHUNK = 4


def autocast(
    device: str, precision: Literal["bfloat16", "float32"]
) -> contextlib.AbstractContextManager[None]:
    """Return the context in which the network runs at a precision."""
    enabled = precision == "bfloat16"
    kind = torch.device(device).type
    return torch.autocast(kind, torch.bfloat16, enabled=enabled)


def held_out_sets(spec: ShardSpec, count: int) -> Batch:
    """Make the first ``count`` sets of the held-out seed."""
    maker = spec.maker(spec.seed + HELD_OUT_SEED_OFFSET)
    stored = np.stack([maker(k) for k in range(count)])
    return decode_sets(stored)


@torch.no_grad()
def measure_losses(
    model: FourViewDenoiser, batch: Batch, precision: Literal["bfloat16", "float32"]
) -> dict[str, float]:
    """Return squared errors of v: ``input_t300``, ``shape_t300``, ``text_t300``, ... and means."""
    device = batch.images.device
    noise = torch.randn(batch.images.shape, generator=torch.Generator().manual_seed(0)).to(device)
    losses: dict[str, float] = {}
    for name, seen in (
        ("input", only(batch, "input_map")),
        ("shape", only(batch, "shape_map")),
        ("text", only(batch)),
    ):
        for timestep in LOSS_TIMESTEPS:
            at = torch.full((len(noise),), float(timestep), device=device)
            target = velocity(batch.images, noise, at)
            noisy = add_noise(batch.images, noise, at)
            predicted = _predict(model, noisy, seen, at, batch.tokens, precision)
            losses[f"{name}_t{timestep}"] = float((predicted - target).square().mean())
        mean = sum(losses[f"{name}_t{t}"] for t in LOSS_TIMESTEPS) / len(LOSS_TIMESTEPS)
        losses[f"{name}_mean"] = mean
    return losses


def only(batch: Batch, *kept: str) -> Batch:
    """Return the batch with its maps blanked but for those that are kept."""
    maps = ("input_map", "shape_map")
    blank = {name: getattr(batch, name) * 0 for name in maps if name not in kept}
    return dataclasses.replace(batch, **blank)


@torch.no_grad()
def sample_sets(
    model: FourViewDenoiser,
    batch: Batch,
    precision: Literal["bfloat16", "float32"],
    *,
    text_scale: float,
    num_steps: int = _SHEET_STEPS,
) -> Tensor:  # [B, 4, 4, S, S]
    """Sample from pure noise with the batch's maps and prompts."""
    device = batch.images.device
    generator = torch.Generator().manual_seed(1)
    noise = torch.randn(batch.images.shape, generator=generator).to(device)
    no_text = no_text_like(batch.tokens)

    def x0_at(x_t: Tensor, timestep: float) -> Tensor:
        at = torch.full((len(x_t),), timestep, device=device)

        def denoise(passes: list[tuple[bool, bool]]) -> list[Tensor]:
            return [
                x0_from_v(
                    x_t,
                    _predict(
                        model, x_t, batch, at, batch.tokens if with_text else no_text, precision
                    ),
                    at,
                )
                for _, with_text in passes
            ]  # fmt: skip

        x0 = guided_x0(
            denoise, has_input=True, has_text=True, input_scale=1.0, text_scale=text_scale
        )
        return x0.clamp(-1, 1)

    times = even_times(float(NUM_TIMESTEPS - 1), num_steps)
    return ddim(x0_at, scales_like(noise), noise, times)


def save_sample_sheet(
    model: FourViewDenoiser,
    batch: Batch,
    precision: Literal["bfloat16", "float32"],
    path: Path,
) -> None:
    """Draw the first sets of a batch: truth, P, samples with P, with the shape, with neither."""
    fields = (field.name for field in dataclasses.fields(Batch))
    first = Batch(*(getattr(batch, name)[:_SHEET_SETS] for name in fields))
    seen = first.input_map[:, :, :4] * 2 - 1
    with_input = sample_sets(model, only(first, "input_map"), precision, text_scale=1.0)
    with_shape = sample_sets(model, only(first, "shape_map"), precision, text_scale=2.0)
    text_only = sample_sets(model, only(first), precision, text_scale=3.0)
    groups = [first.images, seen, with_input, with_shape, text_only]
    sheet = torch.stack([_over_grey(group) for group in groups], dim=1)  # [B, 4, 4, S, S, 3]
    size = sheet.shape[3]
    rows = sheet.permute(1, 3, 0, 2, 4, 5).reshape(len(groups) * size, -1, 3)
    with atomic_path(path) as temporary:
        Image.fromarray((rows * 255).round().to(torch.uint8).cpu().numpy()).save(temporary, "PNG")


def _over_grey(images: Tensor) -> Tensor:  # [B, 4, 4, S, S] -> [B, 4, S, S, 3]
    color, alpha = images_to_color_alpha(images.flatten(0, 1))
    return (color + (1 - alpha[..., None]) * 0.5).unflatten(0, images.shape[:2])


def _predict(
    model: FourViewDenoiser,
    noisy: Tensor,
    given: Batch,
    timestep: Tensor,
    tokens: Tensor,
    precision: Literal["bfloat16", "float32"],
) -> Tensor:
    """Run the network in small chunks, so that memory stays small."""
    parts = []
    for start in range(0, len(noisy), _CHUNK):
        cut = slice(start, start + _CHUNK)
        with autocast(noisy.device.type, precision):
            maps = (given.input_map[cut], given.shape_map[cut])
            parts.append(model(noisy[cut], *maps, timestep[cut], given.ring[cut], tokens[cut]))
    return torch.cat(parts)


@dataclass(frozen=True, slots=True)
class EvaluateConfig:
    """Which weights to evaluate."""

    out: Path
    """PNG for the sample sheet."""
    weights: Path = field(default_factory=packaged_weights)
    """Folder of exported weights; the default is the package's own."""
    sets: int = 32
    """Number of held-out sets."""
    seed: int = 0
    """Seed of the training run, from which the held-out seed follows."""
    precision: Literal["bfloat16", "float32"] = "bfloat16"


def main() -> int:
    """Run from the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    options = tyro.cli(EvaluateConfig, description=__doc__)
    from recipes.train_embedded_prior.data.source import procedural_source

    try:
        model, _, config = load_weights(options.weights)
        spec = ShardSpec(
            procedural_source,
            DataConfig(),
            config.words,
            config.model.text_length,
            config.model.resolution_px,
            options.seed,
            shard_sets=1,
        )
        batch = held_out_sets(spec, options.sets)
        for name, value in measure_losses(model, batch, options.precision).items():
            _LOG.info("%-12s %.4f", name, value)
        save_sample_sheet(model, batch, options.precision, options.out)
    except UserError as error:
        _LOG.error("%s", error)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
