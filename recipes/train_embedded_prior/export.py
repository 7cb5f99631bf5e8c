"""Turn a checkpoint into shippable weights: ``python -m recipes.train_embedded_prior.export``.

Conventions
-----------
* The averaged (EMA) weights are exported. Words that no caption of the run's generator holds are
  left out, with their embeddings, so that the prior never claims to understand them.
* ``CARD.md`` states what the weights are, how they were made, and what they cost in quality to
  store in eight bits.
"""

from __future__ import annotations

import dataclasses
import logging
import platform
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.jsonio import from_json, read_json
from gscomplete.priors.embedded.model import FourViewDenoiser, count_parameters
from gscomplete.priors.embedded.prior import packaged_weights
from gscomplete.priors.embedded.text import FIRST_WORD_TOKEN, STOP_WORDS, split_words
from gscomplete.priors.embedded.weights import (
    FORMAT_VERSION,
    PriorConfig,
    Storage,
    TrainingRecord,
    load_weights,
    save_weights,
)
from recipes.train_embedded_prior.config import TrainConfig
from recipes.train_embedded_prior.evaluate import held_out_sets, measure_losses
from recipes.train_embedded_prior.shards import ShardSpec
from recipes.train_embedded_prior.state import RUN, RunRecord, TrainState

_LOG = logging.getLogger(__name__)
_WORDS = "text.words.weight"


@dataclass(frozen=True, slots=True)
class ExportConfig:
    """What to export, and where to."""

    run: Path
    """Folder of the training run."""
    out: Path = dataclasses.field(default_factory=packaged_weights)
    """Folder for the weights; the default is the package's own."""
    storage: Storage = "int8"
    captions: int = 4000
    """Captions read to find the words that training has shown."""
    evaluation_sets: int = 32
    """Held-out sets on which the stored weights are compared with the trained ones; 0 = none."""


def words_seen(words: tuple[str, ...], captions: Iterable[str]) -> tuple[str, ...]:
    """Return the words, in their order, that occur in captions."""
    seen = {word for text in captions for word in split_words(text)}
    return tuple(word for word in words if word in seen)


def keep_words(
    state: dict[str, Tensor], words: tuple[str, ...], kept: tuple[str, ...]
) -> dict[str, Tensor]:
    """Return the weights with the embeddings of the kept words only, in the order of ``kept``."""
    rows = [*range(FIRST_WORD_TOKEN), *(FIRST_WORD_TOKEN + words.index(word) for word in kept)]
    return state | {_WORDS: state[_WORDS][torch.tensor(rows)]}


def export(
    train: TrainConfig, state: TrainState, words: tuple[str, ...], kept: tuple[str, ...],
    out: Path, storage: Storage,
) -> PriorConfig:  # fmt: skip
    """Write weights and configuration.

    Returns:
        The configuration that was written.
    """
    size = FIRST_WORD_TOKEN + len(kept)
    sets = state.step * train.batch_sets
    config = PriorConfig(
        format_version=FORMAT_VERSION,
        model=dataclasses.replace(train.model, vocabulary_size=size),
        views=train.data.views(train.model.resolution_px),
        words=kept,
        storage=storage,
        training=TrainingRecord(
            steps=state.step,
            sets=sets,
            hours=round(state.elapsed_s / 3600, 3),
            machine=f"{train.replicas} {train.device} replicas, {platform.machine()}",
            seed=train.seed,
        ),
    )
    save_weights(out, keep_words(state.ema.state_dict(), words, kept), config)
    return config


def card(config: PriorConfig, model: FourViewDenoiser, losses: dict[str, dict[str, float]]) -> str:
    """Describe the weights in Markdown."""
    views, training = config.views, config.training
    lines = [
        "# Embedded prior",
        "",
        "A four-view, camera-, text- and input-conditioned denoiser of premultiplied RGBA images,",
        "trained by `recipes/train_embedded_prior` on procedural objects only: no photographs, no",
        "third-party models, no downloads. Licence: Apache-2.0, as the rest of the repository.",
        "",
        f"* Parameters: {count_parameters(model) / 1e6:.1f} million, stored as {config.storage}.",
        f"* Images: {views.resolution_px} x {views.resolution_px}, field of view "
        f"{views.fov_deg:g} degrees, visible extent {views.extent_range[0]:g} to "
        f"{views.extent_range[1]:g} object sizes, elevation {views.elevation_range_deg[0]:g} to "
        f"{views.elevation_range_deg[1]:g} degrees.",
        f"* Words: {len(config.words)}.",
        f"* Training: {training.steps} steps, {training.sets} four-view sets, each seen once, "
        f"{training.hours:.2f} hours on {training.machine}, seed {training.seed}.",
        "",
    ]
    if losses:
        lines += [
            "Mean squared error of v on held-out objects (all timesteps; see `evaluate.py`):",
            "",
            "| weights | seeing P | text alone |",
            "| --- | --- | --- |",
            *(
                f"| {name} | {values['input_mean']:.4f} | {values['text_mean']:.4f} |"
                for name, values in losses.items()
            ),
            "",
        ]
    lines += [
        "Known limits: one object per image, the things named by its words and simple shapes,",
        "64 x 64 pixels; coarse shape and the colours of P are reliable, lettering and fine",
        "texture are not, and what is said only by the prompt is followed loosely.",
        "",
    ]
    return "\n".join(lines)


def main() -> int:
    """Run from the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    options = tyro.cli(ExportConfig, description=__doc__)
    from recipes.train_embedded_prior.procedural.objects import make_object
    from recipes.train_embedded_prior.source import procedural_source

    try:
        record = from_json(RunRecord, read_json(options.run / RUN), str(options.run / RUN))
        train = dataclasses.replace(record.config, out=options.run)
        state = TrainState.start(train)
        state.load(options.run)
        captions = (make_object(train.seed, index).caption for index in range(options.captions))
        kept = words_seen(record.words, captions)
        export(train, state, record.words, kept, options.out, options.storage)
        model, config = load_weights(options.out)
    except UserError as error:
        _LOG.error("%s", error)
        return error.exit_code
    losses = {}
    if options.evaluation_sets:
        spec = ShardSpec(
            procedural_source, train.data, kept, config.model.text_length,
            config.model.resolution_px, train.seed, train.shard_sets,
        )  # fmt: skip
        batch = held_out_sets(spec, options.evaluation_sets)
        trained = FourViewDenoiser(config.model)
        trained.load_state_dict(keep_words(state.ema.state_dict(), record.words, kept))
        losses["trained, float32"] = measure_losses(trained, batch, "float32")
        losses[f"shipped, {options.storage}"] = measure_losses(model, batch, "float32")
        losses[f"shipped, {options.storage}, run in bfloat16"] = measure_losses(
            model, batch, "bfloat16"
        )
    (options.out / "CARD.md").write_text(card(config, model, losses), encoding="utf-8")
    size = sum(path.stat().st_size for path in options.out.iterdir())
    left_out = sorted(set(record.words) - set(kept) - STOP_WORDS)
    _LOG.info("%s: %.1f MB, %d words", options.out, size / 1e6, len(kept))
    _LOG.info("left out, in no caption: %s", " ".join(left_out) or "none")
    return 0


if __name__ == "__main__":
    sys.exit(main())
