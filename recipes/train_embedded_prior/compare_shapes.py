"""Compare shape networks on parts of meshes that none was trained on.

``python -m recipes.train_embedded_prior.compare_shapes --meshes PACK --out DIR --networks W1 W2``
makes parts of the pack's validation split once, keeps them in ``DIR``, and evaluates every network
on them. Given runs of ``train shape --mesh-count N``, it shows validation IoU against the number of
meshes; given copies of one run folder taken during training, against training time.

Conventions
-----------
* A network is a folder of exported weights, or a run folder, whose averaged weights are asked.
* Half of the answers are given without a prompt, alternately, as in a run (``shape.predict``).
* IoU is of filled cells (logit above 0), per part; intervals are 95 % bootstrap intervals over
  parts, of differences over the same parts.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.evaluate.bootstrap import bootstrap_interval
from gscomplete.priors.embedded.text import no_text_like
from gscomplete.priors.embedded.weights import load_weights
from gscomplete.shape.ask import ORIENTATIONS, answer_in, mean_of
from gscomplete.shape.network import ShapeCompleter
from gscomplete.util import jsonio
from gscomplete.util.atomic import atomic_path
from recipes.entry_point import start
from recipes.train_embedded_prior.config import ShapeDataConfig
from recipes.train_embedded_prior.data.dataset import HELD_OUT_SEED_OFFSET
from recipes.train_embedded_prior.data.mesh_source import MixedSource
from recipes.train_embedded_prior.data.shape_dataset import ShapeBatch, ShapeSpec, decode_sets
from recipes.train_embedded_prior.export import TrainedRun
from recipes.train_embedded_prior.shape_task import cell_ious
from recipes.train_embedded_prior.state import RUN


@dataclass(frozen=True)
class Options:
    """Compare shape networks on held-out parts of meshes."""

    meshes: Path
    """Pack of meshes."""
    out: Path
    """Folder for the parts, which are made once, and for ``compared.json``."""
    networks: tuple[Path, ...]
    """Folders of weights or run folders; the others are compared with the first."""
    parts: int = 200
    """Held-out parts."""
    orientations: int = ORIENTATIONS
    """Orientations, of eight, in which each network is evaluated; its answers are averaged."""
    seed: int = 0


def main(options: Options) -> None:
    """Measure and print."""
    rows = {}
    for path in options.networks:
        model, words = load_network(path)
        batch = held_out_parts(options, words)
        rows[str(path)] = part_ious(model, batch, options.orientations)
        sys.stdout.write(line_of(path, rows[str(path)], next(iter(rows.values()))))
        sys.stdout.flush()
    options.out.mkdir(parents=True, exist_ok=True)
    jsonio.write_json(options.out / "compared.json", rows)


def line_of(path: Path, ious: list[float], first: list[float]) -> str:
    """Return a network's line: its mean and its gain over the first network, with intervals."""
    low, high = bootstrap_interval(ious)
    gains = [a - b for a, b in zip(ious, first, strict=True)]
    least, most = bootstrap_interval(gains)
    return (
        f"{np.mean(ious):.4f} ({low:.4f} to {high:.4f})  {np.mean(gains):+.4f} "
        f"({least:+.4f} to {most:+.4f})  n = {len(ious)}  {path}\n"
    )


def load_network(path: Path) -> tuple[ShapeCompleter, tuple[str, ...]]:
    """Read a network and the words that it knows.

    Raises:
        UserError: there is none.
    """
    if not (path / RUN).exists():
        _, shape, record = load_weights(path)
        if shape is None or record.shape is None:
            raise UserError(f"{path}: expected a shape network, found none")
        return shape, record.shape.words
    run = TrainedRun.load(path)
    if not isinstance(run.state.ema, ShapeCompleter):
        raise UserError(f"{path}: expected a run of the shape network, found one of the denoiser")
    return run.state.ema.eval(), run.words


def held_out_parts(options: Options, words: tuple[str, ...]) -> ShapeBatch:
    """Return the parts, made once for every vocabulary."""
    source = MixedSource(options.meshes, 1.0)
    data = ShapeDataConfig(mesh_share=1.0)
    spec = ShapeSpec(source, data, words, options.seed, 1)
    path = options.out / f"parts-{options.parts}-{spec.key()}.npy"
    if not path.exists():
        maker = spec.maker(options.seed + HELD_OUT_SEED_OFFSET)
        path.parent.mkdir(parents=True, exist_ok=True)
        made = np.stack([maker(k) for k in range(options.parts)])
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.save(file, made)
    return decode_sets(np.load(path))


@torch.no_grad()
def part_ious(model: ShapeCompleter, batch: ShapeBatch, orientations: int) -> list[float]:
    """Return the IoU of filled cells of every part."""
    given = batch.volumes, batch.evidence, batch.scores
    prompts = batch.tokens, no_text_like(batch.tokens)
    found = []
    for k in range(len(batch.solid)):
        asked = [part[k : k + 1] for part in given]
        answers = [
            answer_in(model, *asked, prompts[o % 2][k : k + 1], o, bfloat16=True)
            for o in range(orientations)
        ]
        filled = mean_of(answers).occupancy > 0
        found.append(float(cell_ious(filled, batch.solid[k : k + 1] > 0)))
    return found


if __name__ == "__main__":
    start(main, Options, __doc__)
