"""Training of the shape network: its sets, loss and evaluation.

Conventions
-----------
* The loss is the cross entropy of the filled cells, heavier near the complete object's surface and
  at thin parts, plus what Tversky indices of the filled cells and of their shadows (along the axes
  and two oblique directions) lack of 1, plus the absolute error of the surface's colour where P
  is not. The cross entropy alone leaves thin objects out: they have few cells, none certain.
* While training, a source's colour in a cell is that of its filled cells nearby.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image
from torch import Tensor, nn

from gscomplete.priors.embedded.text import no_text_like
from gscomplete.shape.network import ShapeCompleter, ShapeOutput, laid_out
from gscomplete.shape.symmetry import SOURCES
from gscomplete.shape.voxels import COARSE_CELLS, grown
from gscomplete.util.atomic import atomic_path
from recipes.train_embedded_prior.config import ShapeTrainConfig
from recipes.train_embedded_prior.data.dataset import HELD_OUT_SEED_OFFSET, Source
from recipes.train_embedded_prior.data.shape_dataset import (
    ShapeBatch,
    ShapeSpec,
    decode_sets,
    turn_batch,
)
from recipes.train_embedded_prior.evaluate import autocast

_SURFACE_WEIGHT = 4.0
_THIN_WEIGHT = 4.0
"""Of the cells of thin parts and those beside them."""
_MISS_WEIGHT, _EXCESS_WEIGHT = 1.3, 0.7
"""Of what is missed and what is too much, in overlaps."""
_LEAST_FREE = 1e-6
"""No cell blocks a ray more surely than to this probability."""
_OVERLAP_WEIGHT = 1.0
_SHADOW_WEIGHT = 2.0
_COLOR_WEIGHT = 0.5
_SEEN_WEIGHT = 0.1
_SHEET_SETS = 8

LossOf = Callable[[nn.Module, ShapeBatch, Tensor, Tensor], Tensor]
"""(network, sets, weights of cells, turn of oblique shadows) -> loss []."""


@dataclass(frozen=True, slots=True)
class ShapeTask:
    """What the trainer trains."""

    config: ShapeTrainConfig
    source: Source
    words: tuple[str, ...]

    @property
    def behind(self) -> int:
        """How many shards behind the newest a step may read."""
        return self.config.replay_shards + 1

    @property
    def spec(self) -> ShapeSpec:
        """What training sets are."""
        c = self.config
        return ShapeSpec(self.source, c.data, self.words, c.seed, c.shard_sets)

    def make_model(self) -> nn.Module:
        """Build the network."""
        return laid_out(ShapeCompleter(self.config.model, COARSE_CELLS))

    def set_indices(self, step: int) -> Sequence[int]:
        """Return the sets of a step: some of the past, then the new ones."""
        fresh = self.config.fresh_sets
        first = step * fresh
        reach = min(first, self.config.replay_shards * self.config.shard_sets)
        old = self.config.batch_sets - fresh
        if reach < self.config.shard_sets:
            return [first + k % fresh for k in range(old)] + list(range(first, first + fresh))
        rng = np.random.default_rng((self.config.seed, step, 5))
        past = first - 1 - rng.integers(reach, size=old)
        return [*past.tolist(), *range(first, first + fresh)]

    def loss(self, model: nn.Module, stored: np.ndarray, step: int, own: slice) -> Tensor:  # []
        """Return the loss of this replica's share of a step."""
        rng = np.random.default_rng((self.config.seed, step, 6, own.start))
        batch = decode_sets(stored)
        batch = turn_batch(batch, int(rng.integers(4)), bool(rng.random() < 0.5))
        return self.batch_loss(model, batch.to(self.config.device), rng)

    def batch_loss(
        self,
        model: nn.Module,
        batch: ShapeBatch,
        rng: np.random.Generator,
        loss_of: LossOf | None = None,
    ) -> Tensor:  # []
        """Return the loss of sets that are on the device.

        Args:
            model: the network.
            batch: the sets.
            rng: draws which sets lose their text, and the directions of shadows.
            loss_of: computes what ``total_loss`` does; None = that.
        """
        loss_of = loss_of or total_loss
        dropped = torch.from_numpy(rng.random(len(batch.tokens)) < self.config.drop_text)
        no_text = no_text_like(batch.tokens)
        tokens = torch.where(dropped.to(no_text.device)[:, None], no_text, batch.tokens)
        oblique = oblique_turn(rng).to(no_text.device)
        batch = dataclasses.replace(batch, tokens=tokens)
        return loss_of(model, batch, cell_weights(batch.solid), oblique)

    def evaluate(self, model: nn.Module, sheet: Path) -> dict[str, float]:
        """Measure on held-out sets and draw a sheet."""
        batch = self._held_out()
        out = self._predict(model, batch)
        save_sheet(out, batch, sheet)
        return _measured(out, batch)

    def measure(self, model: nn.Module) -> dict[str, float]:
        """Measure on held-out sets."""
        batch = self._held_out()
        return _measured(self._predict(model, batch), batch)

    def _held_out(self) -> ShapeBatch:
        maker = self.spec.maker(self.config.seed + HELD_OUT_SEED_OFFSET)
        return decode_sets(np.stack([maker(k) for k in range(self.config.evaluation_sets)]))

    @torch.no_grad()
    def _predict(self, model: nn.Module, batch: ShapeBatch) -> ShapeOutput:
        there = batch.to(self.config.device)
        with autocast(self.config.device, self.config.precision):
            out: ShapeOutput = model(there.volumes, there.evidence, there.scores, there.tokens)
        return ShapeOutput(out.occupancy.cpu(), out.colors.cpu(), out.sources.cpu())


def _measured(out: ShapeOutput, batch: ShapeBatch) -> dict[str, float]:
    rng = np.random.default_rng(0)
    parts = shape_losses(out, batch, cell_weights(batch.solid), oblique_turn(rng))
    losses = {name: float(value) for name, value in parts.items()}
    return losses | filled_iou(out, batch)


def total_loss(model: nn.Module, batch: ShapeBatch, weights: Tensor, oblique: Tensor) -> Tensor:
    """Return the loss [] of a network, its parts weighted.

    Args:
        model: the network.
        batch: the sets, on its device.
        weights: as ``shape_losses`` takes them.
        oblique: likewise.
    """
    out = model(batch.volumes, batch.evidence, batch.scores, batch.tokens)
    losses = shape_losses(out, batch, weights, oblique)
    return (
        losses["occupancy"]
        + _OVERLAP_WEIGHT * losses["overlap"]
        + _SHADOW_WEIGHT * losses["shadow"]
        + _COLOR_WEIGHT * losses["color"]
    )


def cell_weights(solid: Tensor) -> Tensor:  # [B, C, C, C] -> [B, C, C, C]
    """Return what cells weigh in the cross entropy: more near the surface and at thin parts."""
    around = grown(solid) + grown(1 - solid)
    return 1 + _SURFACE_WEIGHT * (around - 1) + _THIN_WEIGHT * grown(thin_cells(solid))


def shape_losses(
    out: ShapeOutput, batch: ShapeBatch, weights: Tensor, oblique: Tensor
) -> dict[str, Tensor]:
    """Return the parts of the loss.

    Args:
        out: the network's answer.
        batch: the sets.
        weights: [B, C, C, C] of the cells (``cell_weights``).
        oblique: [3, 3] turn to the oblique directions of shadows (``oblique_turn``).
    """
    solid = batch.solid
    occupancy = F.binary_cross_entropy_with_logits(out.occupancy, solid, reduction="none")
    true_colors, there = coarse_colors(batch.surface)
    error = (blended_colors(out, batch.volumes) - true_colors).abs().mean(dim=1)
    seen = F.max_pool3d(batch.volumes[:, 0, :1], 2)[:, 0] > 0
    where = there * torch.where(seen, _SEEN_WEIGHT, 1.0)
    filled = out.occupancy.float().sigmoid()
    shadow = torch.stack(
        [
            shadow_overlap(filled, solid, (1, 2, 3)),
            shadow_overlap(*_turned(filled, solid, oblique), (1, 2)),
        ]
    )
    return {
        "occupancy": (weights * occupancy).mean() * 10,
        "overlap": 1 - soft_overlap(out.occupancy.sigmoid(), solid).mean(),
        "shadow": 1 - shadow.mean(),
        "color": (where * error).sum() / where.sum().clamp_min(1.0),
    }


def thin_cells(solid: Tensor) -> Tensor:  # [B, C, C, C] -> [B, C, C, C]
    """Return 1 for filled cells that no filled block of 3 x 3 x 3 cells holds."""
    return solid - grown(1 - grown(1 - solid))


def soft_overlap(filled: Tensor, solid: Tensor) -> Tensor:  # [B, ...] both -> [B]
    """Return the Tversky index of shares in [0, 1], misses weighted above excess; 1 if equal."""
    both = torch.minimum(filled, solid).flatten(1).sum(dim=1)
    missed = (solid - filled).clamp_min(0).flatten(1).sum(dim=1)
    excess = (filled - solid).clamp_min(0).flatten(1).sum(dim=1)
    return both / (both + _MISS_WEIGHT * missed + _EXCESS_WEIGHT * excess).clamp_min(1.0)


def shadow_overlap(
    filled: Tensor,  # [B, C, C, C] probabilities
    solid: Tensor,  # [B, C, C, C] shares in [0, 1]
    axes: Sequence[int],
) -> Tensor:  # [B]
    """Return the overlap of the shadows along some axes, their mean.

    A ray is free with the product of its cells' probabilities to be empty.
    """
    ours, true = (-torch.log1p(-x.clamp(max=1 - _LEAST_FREE)) for x in (filled, solid))
    shares = [
        soft_overlap(-torch.expm1(-ours.sum(dim=axis)), -torch.expm1(-true.sum(dim=axis)))
        for axis in axes
    ]
    return torch.stack(shares).mean(dim=0)


def oblique_turn(rng: np.random.Generator) -> Tensor:  # [3, 3]
    """Draw a turn by any azimuth and an elevation of -10 to 45 degrees."""
    azimuth, elevation = rng.uniform(0, 2 * math.pi), math.radians(rng.uniform(-10, 45))
    cos, sin = math.cos(azimuth), math.sin(azimuth)
    up, flat = math.sin(elevation), math.cos(elevation)
    about_z = torch.tensor([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    lean = torch.tensor([[flat, 0.0, -up], [0.0, 1.0, 0.0], [up, 0.0, flat]])
    return about_z @ lean


def _turned(
    filled: Tensor,  # [B, C, C, C]
    solid: Tensor,  # [B, C, C, C]
    oblique: Tensor,  # [3, 3]
) -> tuple[Tensor, Tensor]:
    """Turn both; outside is empty."""
    matrix = torch.cat([oblique, oblique.new_zeros(3, 1)], dim=1).to(filled)
    count, size = len(filled), tuple(filled.shape[1:])
    # grid_sample names the last axis x: the volume's axes are handed over in reverse.
    grid = F.affine_grid(matrix.expand(count, -1, -1), [count, 1, *size], align_corners=False)
    pair = torch.stack([filled, solid], dim=1).permute(0, 1, 4, 3, 2)
    seen = F.grid_sample(pair, grid, align_corners=False).permute(0, 1, 4, 3, 2)
    return seen[:, 0], seen[:, 1]


def coarse_colors(volume: Tensor) -> tuple[Tensor, Tensor]:
    """Return mean colours of coarse cells [B, 3, n, n, n] and where there are any [B, n, n, n].

    Args:
        volume: [B, 4, C, C, C], occupancy and colour.
    """
    weight = volume[:, :1]
    pooled = F.avg_pool3d(torch.cat([weight, volume[:, 1:] * weight], dim=1), 2)
    return pooled[:, 1:] / pooled[:, :1].clamp_min(1e-4), pooled[:, 0] > 1e-4


def blended_colors(out: ShapeOutput, volumes: Tensor) -> Tensor:  # [B, 3, C/2, C/2, C/2]
    """Mix the sources' colours near each coarse cell and the network's own."""
    flat = volumes.flatten(0, 1)
    weight = flat[:, :1]
    pooled = F.avg_pool3d(torch.cat([weight, flat[:, 1:] * weight], dim=1), 2)
    near = F.avg_pool3d(pooled, 3, 1, 1).unflatten(0, (-1, SOURCES))
    known = near[:, :, 0] > 1e-4
    colors = near[:, :, 1:] / near[:, :, :1].clamp_min(1e-4)
    logits = torch.cat(
        [out.sources[:, :SOURCES].masked_fill(~known, -30.0), out.sources[:, SOURCES:]], dim=1
    )
    share = logits.softmax(dim=1)
    mixed = (share[:, :SOURCES, None] * colors).sum(dim=1)
    return mixed + share[:, SOURCES:] * out.colors


def cell_ious(ours: Tensor, theirs: Tensor) -> Tensor:  # [B, C, C, C] bool both -> [B]
    """Return the intersection over union of filled cells of every object."""
    cells = (1, 2, 3)
    return (ours & theirs).sum(dim=cells) / (ours | theirs).sum(dim=cells).clamp_min(1)


def filled_iou(out: ShapeOutput, batch: ShapeBatch) -> dict[str, float]:
    """Return mean intersections over union: of the network, and of P with its best mirror image."""
    inside = out.occupancy > 0
    missing = batch.surface[:, 0] > 0
    missing &= grown(batch.volumes[:, 0, 0]) == 0
    found = (missing & inside).sum() / missing.sum().clamp_min(1)
    copied = grown(batch.volumes[:, 1, 0]) > 0
    copy_found = (missing & copied).sum() / missing.sum().clamp_min(1)
    return {
        "iou": float(cell_ious(inside, batch.solid > 0).mean()),
        "hidden_recall": float(found),
        "copy_recall": float(copy_found),
    }


def save_sheet(out: ShapeOutput, batch: ShapeBatch, path: Path) -> None:
    """Draw truth, P and prediction from two sides and from above, as first filled cells."""
    columns = []
    colors = F.interpolate(blended_colors(out, batch.volumes), scale_factor=2.0)
    for n in range(min(_SHEET_SETS, len(batch.solid))):
        rows = []
        for filled, color in (
            (batch.surface[n, 0] > 0, batch.surface[n, 1:]),
            (batch.volumes[n, 0, 0] > 0, batch.volumes[n, 0, 1:]),
            (out.occupancy[n] > 0, colors[n]),
        ):
            for axis, backward in ((0, False), (0, True), (1, False), (2, True)):
                rows.append(_first_filled(filled, color, axis, backward))
        columns.append(torch.cat(rows, dim=0))
    pixels = (torch.cat(columns, dim=1).clamp(0, 1) * 255).round().to(torch.uint8).numpy()
    with atomic_path(path) as temporary:
        image = Image.fromarray(pixels)
        image.resize((image.width * 2, image.height * 2), Image.Resampling.NEAREST).save(
            temporary, "PNG"
        )


def _first_filled(filled: Tensor, color: Tensor, axis: int, backward: bool) -> Tensor:
    """Draw the first filled cells along an axis, z up."""
    if backward:
        filled, color = filled.flip(axis), color.flip(axis + 1)
    first = filled.float().argmax(dim=axis, keepdim=True)
    seen = color.gather(axis + 1, first[None].expand(3, *first.shape)).squeeze(axis + 1)
    seen = torch.where(filled.any(dim=axis)[None], seen, torch.full_like(seen, 0.5))
    return seen.permute(2, 1, 0).flip(0)
