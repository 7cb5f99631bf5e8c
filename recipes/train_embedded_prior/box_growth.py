"""Train the network that guesses the complete object's box (``gscomplete.framing.growth``).

``python -m recipes.train_embedded_prior.box_growth --meshes PACK --out DIR`` makes parts of meshes
and procedural objects (kept in ``DIR/parts.npz``, so that another training starts at once), trains
on the pack's training split and measures on its validation split. ``growth.safetensors`` then goes
into ``gscomplete/framing/weights``.

Conventions
-----------
* One object gives several parts. Of each the target is how far the complete object's box reaches
  beyond the part's, in sides of the part's box (x-, x+, y-, y+, z-, z+).
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from rich.progress import track
from safetensors.torch import save_file
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.framing.growth import WEIGHTS_FILE, GrowthNetwork, oriented, partial_volume
from gscomplete.framing.guess import FramingSettings, object_splats, points_and_normals
from gscomplete.splats import Splats
from recipes.entry_point import start
from recipes.train_embedded_prior.dataset import HELD_OUT_SEED_OFFSET
from recipes.train_embedded_prior.mesh_source import MixedSource
from recipes.train_embedded_prior.procedural.quads import FloatArray
from recipes.train_embedded_prior.user_parts import user_part

_LOG = logging.getLogger(__name__)
_PARTS_PER_OBJECT = 5
_SLIGHT_SHARE = 0.3
_DISTURBED_SHARE = 0.5
_SEED = 31
_BATCH = 32
_MESH_SHARE = 0.85
_QUADRATIC_BELOW = 0.2
"""Errors of growths below this count squared."""


@dataclass(frozen=True)
class Options:
    """Train the network that guesses the complete object's box."""

    meshes: Path
    """Folder of the pack of meshes."""
    out: Path
    """Folder of parts and weights."""
    objects: int = 1500
    """Objects to make parts of."""
    held_out: int = 100
    """Objects of the validation split to measure on."""
    epochs: int = 8
    learning_rate: float = 1e-3


@dataclass(frozen=True, slots=True)
class Parts:
    """Parts and how far the objects reach beyond them."""

    volumes: NDArray[np.uint8]  # [N, 4, C, C, C]
    targets: FloatArray  # [N, 6]

    def batch(self, index: NDArray[np.intp] | slice) -> tuple[Tensor, Tensor]:
        """Return volumes [B, 4, C, C, C] in [-1, 1] and targets [B, 6]."""
        volumes = (torch.from_numpy(self.volumes[index]).float() - 128) / 127
        return volumes, torch.from_numpy(self.targets[index])


def make_parts(source: MixedSource, seed: int, count: int) -> Parts:
    """Make the parts of so many objects."""
    volumes, targets = [], []
    for index in track(range(count), "objects"):
        item = source(seed, index)
        for k in range(_PARTS_PER_OBJECT):
            rng = np.random.default_rng((seed, index, k, 30))
            part = user_part(
                item.splats,
                seed,
                index * _PARTS_PER_OBJECT + k,
                disturb=bool(rng.random() < _DISTURBED_SHARE),
                slight=bool(rng.random() < _SLIGHT_SHARE),
            )
            try:
                kept, _ = object_splats(part, FramingSettings())
            except UserError:
                continue
            low, high = (corner.double().numpy() for corner in kept.bounds())
            if float((high - low).max()) > 0.05:
                volume = partial_volume(*points_and_normals(kept))
                volumes.append(np.round(volume * 127 + 128).astype(np.uint8))
                targets.append(growth_of(kept, item.splats))
    return Parts(np.stack(volumes), np.stack(targets))


def growth_of(part: Splats, complete: Splats) -> FloatArray:  # [6]
    """Return how far the complete object reaches; see the module's conventions."""
    low, high = (corner.double().numpy() for corner in part.bounds())
    all_low, all_high = (corner.double().numpy() for corner in complete.bounds())
    size = float((high - low).max())
    target = np.empty(6, np.float32)
    target[::2], target[1::2] = (low - all_low) / size, (all_high - high) / size
    return np.maximum(target, 0.0)


def growth_loss(found: Tensor, target: Tensor) -> Tensor:  # [B, 6] both -> []
    """Return the error of growths, and of the centre and the sides that follow.

    Most growths are 0: an absolute error would be smallest for a network that always answers 0.
    """
    difference = found - target
    center = difference[:, 1::2] - difference[:, ::2]
    side = difference[:, 1::2] + difference[:, ::2]
    parts = [
        F.smooth_l1_loss(part, torch.zeros_like(part), beta=_QUADRATIC_BELOW)
        for part in (difference, center, side)
    ]
    return torch.stack(parts).sum()


def train(options: Options, parts: Parts) -> GrowthNetwork:
    """Train on all parts, each epoch in other orientations."""
    torch.manual_seed(_SEED)
    model = GrowthNetwork()
    optimizer = torch.optim.AdamW(model.parameters(), lr=options.learning_rate, weight_decay=0.02)
    per_epoch = len(parts.volumes) // _BATCH
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, options.learning_rate, options.epochs * per_epoch
    )
    rng = np.random.default_rng(_SEED)
    model.train()
    for epoch in range(options.epochs):
        order, total, began = rng.permutation(len(parts.volumes)), 0.0, time.monotonic()
        for step in range(per_epoch):
            volume, target = parts.batch(order[step * _BATCH : (step + 1) * _BATCH])
            volume, target = oriented(
                volume, target, int(rng.integers(4)), bool(rng.random() < 0.5)
            )
            loss = growth_loss(model(volume), target)
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            optimizer.step()
            schedule.step()
            total += float(loss.detach())
        seconds = time.monotonic() - began
        _LOG.info("epoch %d: loss %.4f, %.0f s", epoch, total / per_epoch, seconds)
    return model.eval()


def report(model: GrowthNetwork, held_out: Parts) -> str:
    """Say how far off the network is on held-out parts."""
    volumes, target = held_out.batch(slice(None))
    growth = model.averaged(volumes)
    error, none = (growth - target).square().mean().sqrt(), target.square().mean().sqrt()
    return f"{len(target)} held-out parts: growths off by {error:.3f} (none: {none:.3f}), RMS"


def main(options: Options) -> None:
    """Make parts, train, measure."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    torch.set_num_threads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    kept = options.out / "parts.npz"
    if not kept.exists():
        only_meshes = MixedSource(options.meshes, 1.0)
        held = make_parts(only_meshes, _SEED + HELD_OUT_SEED_OFFSET, options.held_out)
        made = make_parts(MixedSource(options.meshes, _MESH_SHARE), _SEED, options.objects)
        np.savez_compressed(
            kept, v=made.volumes, t=made.targets, held_v=held.volumes, held_t=held.targets
        )
    with np.load(kept) as stored:
        made, held = Parts(stored["v"], stored["t"]), Parts(stored["held_v"], stored["held_t"])
    model = train(options, made)
    save_file(model.state_dict(), options.out / WEIGHTS_FILE)
    _LOG.info("%s", report(model, held))


if __name__ == "__main__":
    start(main, Options, __doc__)
