"""Training of the four-view denoiser: its sets, noise, loss and evaluation.

Conventions
-----------
* The loss is the mean over sets of ``loss_weight(t) * mean((v - v_hat)^2)`` (``diffusion``).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from gscomplete.priors.embedded.diffusion import NUM_TIMESTEPS, add_noise, loss_weight, velocity
from gscomplete.priors.embedded.model import IMAGE_CHANNELS, VIEWS, FourViewDenoiser
from gscomplete.priors.embedded.text import no_text_like
from recipes.train_embedded_prior.config import TrainConfig
from recipes.train_embedded_prior.data.dataset import Batch, Source, decode_sets
from recipes.train_embedded_prior.data.shards import ShardSpec
from recipes.train_embedded_prior.evaluate import (
    held_out_sets,
    measure_losses,
    save_sample_sheet,
)


@dataclass(frozen=True, slots=True)
class ViewsTask:
    """What the trainer trains."""

    config: TrainConfig
    source: Source
    words: tuple[str, ...]
    behind: int = 1

    @property
    def spec(self) -> ShardSpec:
        """What training sets are."""
        size = self.config.model
        return ShardSpec(
            self.source, self.config.data, self.words, size.text_length, size.resolution_px,
            self.config.seed, self.config.shard_sets,
        )  # fmt: skip

    def make_model(self) -> nn.Module:
        """Build the network."""
        return FourViewDenoiser(self.config.model)

    def set_indices(self, step: int) -> Sequence[int]:
        """Return the sets of a step: every set is used once."""
        first = step * self.config.batch_sets
        return range(first, first + self.config.batch_sets)

    def loss(self, model: nn.Module, stored: np.ndarray, step: int, own: slice) -> Tensor:  # []
        """Return the loss of this replica's share of a step."""
        batch = decode_sets(stored).to(self.config.device)
        drawn = draw_step_noise(self.config, step).select(own, self.config.device)
        return training_loss(model, batch, drawn)

    def evaluate(self, model: nn.Module, sheet: Path) -> dict[str, float]:
        """Measure on held-out sets and draw a sheet."""
        assert isinstance(model, FourViewDenoiser)
        batch = held_out_sets(self.spec, self.config.evaluation_sets).to(self.config.device)
        losses = measure_losses(model, batch, self.config.precision)
        save_sample_sheet(model, batch, self.config.precision, sheet)
        return losses


@dataclass(frozen=True, slots=True)
class StepNoise:
    """The random part of one step."""

    timestep: Tensor  # [B]
    noise: Tensor  # [B, 4, 4, S, S]
    keep_input: Tensor  # [B] bool
    keep_text: Tensor  # [B] bool
    keep_shape: Tensor  # [B] bool

    def select(self, index: slice, device: str) -> StepNoise:
        """Return the part for some of the sets, on a device."""
        fields = dataclasses.fields(self)
        return StepNoise(**{f.name: getattr(self, f.name)[index].to(device) for f in fields})


def draw_step_noise(config: TrainConfig, step: int) -> StepNoise:
    """Draw a step's random numbers from (seed, step).

    Timesteps are stratified over the batch and lean towards the noisy end (half of them above
    750): there shape and colour of what is missing are decided, and runs hardly go below 300.
    """
    count, size = config.batch_sets, config.model.resolution_px
    entropy = np.random.SeedSequence((config.seed, step, 3)).generate_state(1, np.uint64)[0]
    generator = torch.Generator().manual_seed(int(entropy >> np.uint64(1)))
    strata = torch.randperm(count, generator=generator) + torch.rand(count, generator=generator)
    noise = torch.randn(count, VIEWS, IMAGE_CHANNELS, size, size, generator=generator)
    keep_input = torch.rand(count, generator=generator) >= config.drop_input
    keep_text = torch.rand(count, generator=generator) >= config.drop_text
    keep_shape = torch.rand(count, generator=generator) >= config.drop_shape
    share = 1 - (1 - strata / count) ** 2
    return StepNoise(share * (NUM_TIMESTEPS - 1), noise, keep_input, keep_text, keep_shape)


def training_loss(model: nn.Module, batch: Batch, drawn: StepNoise) -> Tensor:  # []
    """Return the weighted squared error of v with conditions dropped as drawn."""
    noisy = add_noise(batch.images, drawn.noise, drawn.timestep)
    target = velocity(batch.images, drawn.noise, drawn.timestep)
    mapped = batch.input_map * drawn.keep_input[:, None, None, None, None]
    shape = batch.shape_map * drawn.keep_shape[:, None, None, None, None]
    no_text = no_text_like(batch.tokens)
    tokens = torch.where(drawn.keep_text[:, None], batch.tokens, no_text)
    predicted = model(noisy, mapped, shape, drawn.timestep, batch.ring, tokens)
    error = (predicted - target).square().mean(dim=(1, 2, 3, 4))
    return (loss_weight(drawn.timestep) * error).mean()
