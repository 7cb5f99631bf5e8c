"""Train the network that guesses the complete object's box from a part.

``python -m recipes.train_embedded_prior.box_growth --meshes PACK --out DIR`` makes parts of meshes
and procedural objects (kept in ``DIR/parts.npz``, so that another training starts at once), trains
on the pack's training split, and measures on the validation split beside what framing would say
without the network. ``box.safetensors`` goes into ``gscomplete/framing/weights``.

Conventions
-----------
* One object gives several parts. The target is how far the complete object's box reaches beyond the
  part's, in sides of the part's box: x-, x+, y-, y+, z-, z+.
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
from gscomplete.framing.box_growth import (
    WEIGHTS_FILE,
    BoxGrowth,
    growth_of,
    oriented,
    part_volume,
)
from gscomplete.framing.guess import (
    FramingSettings,
    guess_framing,
    object_splats,
    points_and_normals,
)
from gscomplete.splats import Splats
from recipes.entry_point import start
from recipes.train_embedded_prior.dataset import HELD_OUT_SEED_OFFSET
from recipes.train_embedded_prior.mesh_source import MixedSource
from recipes.train_embedded_prior.procedural.quads import FloatArray
from recipes.train_embedded_prior.user_parts import user_part

_LOG = logging.getLogger(__name__)
_PARTS_PER_OBJECT = 5
_SLIGHT_SHARE = 0.15
_DISTURBED_SHARE = 0.5
_SEED = 31
_BATCH = 32
_MESH_SHARE = 0.85
_QUADRATIC_BELOW = 0.2
"""Errors below this, in sides of the part's box, count squared."""


@dataclass(frozen=True)
class Options:
    """Train the network that guesses the complete object's box."""

    meshes: Path
    """Folder of the pack of meshes."""
    out: Path
    """Folder of parts and weights."""
    objects: int = 2500
    """Objects to make parts of."""
    held_out: int = 150
    """Objects of the validation split to measure on."""
    epochs: int = 9
    learning_rate: float = 1e-3


def make_parts(
    source: MixedSource, seed: int, count: int
) -> tuple[NDArray[np.uint8], FloatArray, FloatArray]:
    """Return volumes [N, 4, C, C, C] in bytes, targets [N, 6], and framing's errors [N, 2]."""
    volumes, targets, errors = [], [], []
    held_out = seed >= HELD_OUT_SEED_OFFSET
    for index in track(range(count), "objects"):
        item = source(seed, index)
        for k in range(2 if held_out else _PARTS_PER_OBJECT):
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
            size = float((high - low).max())
            if not size > 0.05:
                continue
            volumes.append(
                np.round(part_volume(*points_and_normals(kept)) * 127 + 128).astype(np.uint8)
            )
            targets.append(growth_of(low, high, item.splats))
            if held_out:
                guess = guess_framing(part)
                errors.append(_frame_errors(np.array(guess.center), guess.size, item.splats))
    return np.stack(volumes), np.stack(targets).astype(np.float32), np.array(errors, np.float32)


def _frame_errors(center: np.ndarray, size: float, complete: Splats) -> tuple[float, float]:
    """Return the distance of centres in true sizes and the logarithm of the ratio of sizes."""
    low, high = (corner.double().numpy() for corner in complete.bounds())
    true_size = float((high - low).max())
    return (
        float(np.linalg.norm(center - (low + high) / 2)) / true_size,
        float(np.log(size / true_size)),
    )


def growth_loss(found: Tensor, target: Tensor) -> Tensor:  # [B, 6] both -> []
    """Return the error of the six growths, and of the centre and the sides that follow from them.

    Most growths are 0: an absolute error would be smallest for a network that always answers 0.
    """
    difference = found - target
    center = difference[:, 1::2] - difference[:, ::2]
    side = difference[:, 1::2] + difference[:, ::2]
    return 10.0 * sum(
        (
            F.smooth_l1_loss(part, torch.zeros_like(part), beta=_QUADRATIC_BELOW)
            for part in (difference, center, side)
        ),
        torch.zeros(()),
    )


def train(options: Options, volumes: NDArray[np.uint8], targets: FloatArray) -> BoxGrowth:
    """Train on all parts, each epoch in other orientations."""
    torch.manual_seed(_SEED)
    model = BoxGrowth()
    optimizer = torch.optim.AdamW(model.parameters(), lr=options.learning_rate, weight_decay=0.02)
    steps = options.epochs * (len(volumes) // _BATCH)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, options.learning_rate, steps)
    rng = np.random.default_rng(_SEED)
    model.train()
    for epoch in range(options.epochs):
        order, total, began = rng.permutation(len(volumes)), 0.0, time.monotonic()
        for first in range(0, len(order) - _BATCH + 1, _BATCH):
            index = order[first : first + _BATCH]
            x = (torch.from_numpy(volumes[index]).float() - 128) / 127
            y = torch.from_numpy(targets[index])
            x, y = oriented(x, y, int(rng.integers(4)), bool(rng.random() < 0.5))
            loss = growth_loss(model(x), y)
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            optimizer.step()
            schedule.step()
            total += float(loss.detach())
        _LOG.info(
            "epoch %d: loss %.4f, %.0f s",
            epoch,
            total / (len(order) // _BATCH),
            time.monotonic() - began,
        )
    return model.eval()


def main(options: Options) -> None:
    """Make parts, train, measure."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    options.out.mkdir(parents=True, exist_ok=True)
    kept = options.out / "parts.npz"
    if not kept.exists():
        source = MixedSource(options.meshes, _MESH_SHARE)
        held = make_parts(
            MixedSource(options.meshes, 1.0), _SEED + HELD_OUT_SEED_OFFSET, options.held_out
        )
        made = make_parts(source, _SEED, options.objects)
        np.savez_compressed(
            kept, v=made[0], t=made[1], held_v=held[0], held_t=held[1], held_e=held[2]
        )
    stored = np.load(kept)
    model = train(options, stored["v"], stored["t"])
    save_file(model.state_dict(), options.out / WEIGHTS_FILE)
    with torch.no_grad():
        found = model.averaged((torch.from_numpy(stored["held_v"]).float() - 128) / 127)
    target = torch.from_numpy(stored["held_t"])
    _LOG.info("held-out loss %.4f", float(growth_loss(found, target)))
    _LOG.info("%s", held_out_table(found.numpy(), stored["held_t"], stored["held_e"]))


def held_out_table(found: FloatArray, target: FloatArray, rules: FloatArray) -> str:
    """Compare frames by the network with those by framing's rules; errors in true sizes."""
    # The part's own box cancels out of differences.
    center = 0.5 * np.linalg.norm(
        (found[:, 1::2] - found[:, ::2]) - (target[:, 1::2] - target[:, ::2]), axis=1
    )
    lines = [
        f"parts {len(found)}",
        f"network: centre off by {center.mean():.3f} sides of the part's box",
        f"rules: centre off by {rules[:, 0].mean():.3f} sizes; |log size| "
        f"{np.abs(rules[:, 1]).mean():.3f}; below .75 of the truth "
        f"{100 * (rules[:, 1] < np.log(0.75)).mean():.0f} %",
    ]
    missed = np.abs(found - target).mean()
    lines.append(f"network: growths off by {missed:.4f}; none: {np.abs(target).mean():.4f}")
    return "\n".join(lines)


if __name__ == "__main__":
    start(main, Options, __doc__)
