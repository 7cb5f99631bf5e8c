"""Turn checkpoints into shippable weights: ``python -m recipes.train_embedded_prior.export``.

Conventions
-----------
* The averaged (EMA) weights are exported. Words that no caption of the run's objects holds are left
  out, with their embeddings, so that the prior never claims to understand them; those that the
  weights before it knew stay.
* A network that no run is given for is kept as ``out`` holds it, with its words.
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
from gscomplete.priors.base import PriorViews
from gscomplete.priors.embedded.model import FourViewDenoiser, ModelConfig
from gscomplete.priors.embedded.text import FIRST_WORD_TOKEN, STOP_WORDS, split_words
from gscomplete.priors.embedded.weights import (
    CONFIG_FILE,
    FORMAT_VERSION,
    PriorConfig,
    ShapeRecord,
    Storage,
    TrainingRecord,
    load_weights,
    packaged_weights,
    save_weights,
)
from gscomplete.shape.bank.store import BANK_FILE, read_bank
from gscomplete.shape.network import ShapeModelConfig
from gscomplete.util.jsonio import from_json, read_json
from recipes.train_embedded_prior.card import card
from recipes.train_embedded_prior.config import ShapeTrainConfig, TrainConfig
from recipes.train_embedded_prior.data.mesh_pack import PackEntry, read_manifest
from recipes.train_embedded_prior.data.mesh_source import MixedSource
from recipes.train_embedded_prior.data.source import procedural_source
from recipes.train_embedded_prior.evaluate import held_out_sets, measure_losses
from recipes.train_embedded_prior.procedural.objects import make_object
from recipes.train_embedded_prior.shape_task import ShapeTask
from recipes.train_embedded_prior.state import RUN, RunRecord, TrainState
from recipes.train_embedded_prior.views_task import ViewsTask

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ExportConfig:
    """What to export, and where."""

    run: Path | None = None
    """Folder of the denoiser's training run; None = keep the denoiser that ``out`` holds."""
    shape_run: Path | None = None
    """Folder of the shape network's training run; None = keep that of ``out``, if it has one."""
    shape_share: float = 1.0
    """Share of the run's weights in the shape network's; the rest is of the network that ``out``
    holds, which the run was started from. Below 1 it keeps more of what it could before."""
    out: Path = dataclasses.field(default_factory=packaged_weights)
    """Folder for the weights; the default is the package's own."""
    storage: Storage = "int8"
    words_from: int = 6000
    """Captions read to find the words that training has shown."""
    evaluation_sets: int = 32
    """Held-out sets on which the stored weights are compared with the trained ones; 0 = none."""
    history: str = ""
    """For the card: how the recipe changed while the weights were trained; empty = it did not."""


def words_seen(words: tuple[str, ...], captions: Iterable[str]) -> tuple[str, ...]:
    """Return the words, in their order, that occur in captions."""
    seen = {word for text in captions for word in split_words(text)}
    return tuple(word for word in words if word in seen)


@dataclass(frozen=True, slots=True)
class Exportable:
    """Averaged weights of one network, and what goes with them."""

    model: ModelConfig | ShapeModelConfig
    state: dict[str, Tensor]
    words: tuple[str, ...]
    training: TrainingRecord

    def weights(self, kept: tuple[str, ...]) -> dict[str, Tensor]:
        """Return the weights with the embeddings of the kept words, in their order."""
        name = "words.weight" if isinstance(self.model, ShapeModelConfig) else "text.words.weight"
        special, known = self.state[name].split(
            [FIRST_WORD_TOKEN, len(self.state[name]) - FIRST_WORD_TOKEN]
        )
        place = {word: k for k, word in enumerate(self.words)}
        return self.state | {name: torch.stack([*special, *(known[place[word]] for word in kept)])}

    def with_words(self, kept: tuple[str, ...]) -> Exportable:
        """Return the same with some of its words alone."""
        size = FIRST_WORD_TOKEN + len(kept)
        model = dataclasses.replace(self.model, vocabulary_size=size)
        return Exportable(model, self.weights(kept), kept, self.training)


def blended(after: Exportable, before: Exportable, share: float) -> Exportable:
    """Return weights on the way from those that a run started from to those that it ended with.

    On objects unlike those trained on they are often better than both (Wortsman et al., "Robust
    fine-tuning of zero-shot models", 2022).

    Args:
        after: of the run; its network may have more blocks and more words than before, whose
            words come first.
        before: what the run was started from.
        share: of ``after``, in [0, 1].

    Raises:
        UserError: the words of ``before`` are not the first of ``after``.
    """
    if after.words[: len(before.words)] != before.words:
        raise UserError("export: --shape-share: the run did not start from the weights of --out")
    state = {}
    for name, value in after.state.items():
        start = before.state.get(name)
        if start is None:  # of a new block, which adds nothing before
            state[name] = share * value if ".conv_out." in name else value
            continue
        rest = value[len(start) :] if value.shape != start.shape else value[:0]
        state[name] = torch.cat([torch.lerp(start, value[: len(start)], share), rest])
    return dataclasses.replace(after, state=state)


@dataclass(frozen=True, slots=True)
class TrainedRun:
    """A training run as it stands."""

    config: TrainConfig | ShapeTrainConfig
    state: TrainState
    words: tuple[str, ...]
    before: TrainingRecord | None

    @classmethod
    def load(cls, folder: Path) -> TrainedRun:
        """Read a run folder onto the CPU, whatever it was trained on.

        Raises:
            UserError: the folder holds no run.
        """
        record = from_json(RunRecord, read_json(folder / RUN), str(folder / RUN))
        # The weights come from the checkpoint; those that the run started from may be gone.
        config = dataclasses.replace(record.config, out=folder, start_from=None)
        task = (
            ShapeTask(config, procedural_source, record.words)
            if isinstance(config, ShapeTrainConfig)
            else ViewsTask(config, procedural_source, record.words)
        )
        state = TrainState.start(dataclasses.replace(config, device="cpu"), task.make_model)
        state.load(folder)
        return cls(config, state, record.words, record.before)

    def exportable(self) -> Exportable:
        """Return what the run has made so far."""
        state = self.state.ema.state_dict()
        return Exportable(self.config.model, state, self.words, self.record())

    def record(self) -> TrainingRecord:
        """Say how the weights came to be, those that the run started from included."""
        config = self.config
        per_step = config.fresh_sets if isinstance(config, ShapeTrainConfig) else config.batch_sets
        steps, sets, hours = 0, 0, 0.0
        if self.before is not None:
            steps, sets, hours = self.before.steps, self.before.sets, self.before.hours
        return TrainingRecord(
            steps=steps + self.state.step,
            sets=sets + self.state.step * per_step,
            hours=round(hours + self.state.elapsed_s / 3600, 3),
            machine=f"{config.replicas} {config.device} replicas, {platform.machine()}",
            seed=config.seed,
        )


def export(
    denoiser: Exportable,
    views: PriorViews,
    shape: Exportable | None,
    out: Path,
    storage: Storage,
) -> PriorConfig:
    """Write weights and configuration.

    Args:
        denoiser: the four-view denoiser.
        views: the framing that it was trained with.
        shape: the shape network; None = there is none.
        out: folder to write to.
        storage: precision.

    Returns:
        The configuration that was written.
    """
    assert isinstance(denoiser.model, ModelConfig)
    shape_record = None
    if shape is not None:
        assert isinstance(shape.model, ShapeModelConfig)
        shape_record = ShapeRecord(shape.model, shape.words, shape.training)
    config = PriorConfig(
        format_version=FORMAT_VERSION,
        model=denoiser.model,
        views=views,
        words=denoiser.words,
        storage=storage,
        training=denoiser.training,
        shape=shape_record,
    )
    save_weights(out, denoiser.state, config, None if shape is None else shape.state)
    return config


def trained_meshes(options: ExportConfig) -> dict[str, list[PackEntry]]:
    """Return the meshes that each network's run was trained on; networks without are left out.

    Raises:
        UserError: a run or its pack cannot be read.
    """
    found = {}
    for network, run in (("denoiser", options.run), ("shape network", options.shape_run)):
        if run is None:
            continue
        record = from_json(RunRecord, read_json(run / RUN), str(run / RUN))
        if record.config.meshes is not None:
            entries = read_manifest(record.config.meshes)
            found[network] = [entry for entry in entries if entry.split == "train"]
    return found


def measure_export(
    run: TrainedRun | None, options: ExportConfig
) -> tuple[dict[str, dict[str, float]], dict[str, float]]:
    """Measure the stored weights on held-out sets, the denoiser's beside the trained ones."""
    model, shape, config = load_weights(options.out)
    count = options.evaluation_sets
    if not count:
        return {}, {}
    train = TrainConfig(out=options.out, model=config.model)
    losses = {}
    if run is not None:
        assert isinstance(run.config, TrainConfig)
        train = run.config
    batch = held_out_sets(ViewsTask(train, procedural_source, config.words).spec, count)
    if run is not None:
        trained = FourViewDenoiser(config.model)
        trained.load_state_dict(run.exportable().weights(config.words))
        losses["trained, float32"] = measure_losses(trained, batch, "float32")
    name = f"shipped, {options.storage}"
    losses[name] = measure_losses(model, batch, "float32")
    losses[f"{name}, run in bfloat16"] = measure_losses(model, batch, "bfloat16")
    if shape is None or config.shape is None:
        return losses, {}
    shape_train = ShapeTrainConfig(out=options.out, seed=train.seed, evaluation_sets=count)
    shape_task = ShapeTask(shape_train, procedural_source, config.shape.words)
    return losses, shape_task.measure(shape)


def export_runs(options: ExportConfig) -> tuple[TrainedRun | None, set[str]]:
    """Read the runs and write the weights.

    Returns:
        The denoiser's run, if there is one, and the words of the runs that are left out.

    Raises:
        UserError: there is no run, or a run or the weights to keep cannot be read, or the weights
            cannot be written.
    """
    if options.run is None and options.shape_run is None:
        raise UserError("export: expected --run, --shape-run or both, found neither")
    if not 0 < options.shape_share <= 1:
        raise UserError(f"--shape-share: expected above 0, at most 1; found {options.shape_share}")
    run = None if options.run is None else TrainedRun.load(options.run)
    shape_run = None if options.shape_run is None else TrainedRun.load(options.shape_run)
    denoiser, views, shape = _held(options.out, needed=run is None)
    left_out: set[str] = set()
    if run is not None:
        assert isinstance(run.config, TrainConfig)
        denoiser = _of_seen_words(run, options.words_from, run.exportable(), denoiser)
        views = run.config.data.views(run.config.model.resolution_px)
        left_out |= set(run.words) - set(denoiser.words)
    if shape_run is not None:
        trained = shape_run.exportable()
        if options.shape_share < 1:
            if shape is None:
                raise UserError(
                    f"{options.out}: --shape-share: expected a shape network, found none"
                )
            trained = blended(trained, shape, options.shape_share)
        shape = _of_seen_words(shape_run, options.words_from, trained, shape)
        left_out |= set(shape_run.words) - set(shape.words)
    assert denoiser is not None
    assert views is not None
    export(denoiser, views, shape, options.out, options.storage)
    return run, left_out - STOP_WORDS


def _held(
    folder: Path, *, needed: bool
) -> tuple[Exportable | None, PriorViews | None, Exportable | None]:
    """Return what a folder of weights holds: denoiser, its framing, shape network.

    Raises:
        UserError: they cannot be read, and are needed or there.
    """
    if not needed and not (folder / CONFIG_FILE).is_file():
        return None, None, None
    model, shape, held = load_weights(folder)
    denoiser = Exportable(held.model, model.state_dict(), held.words, held.training)
    if shape is None or held.shape is None:
        return denoiser, held.views, None
    record = held.shape
    return (
        denoiser,
        held.views,
        Exportable(record.model, shape.state_dict(), record.words, record.training),
    )


def _of_seen_words(
    run: TrainedRun, count: int, made: Exportable, before: Exportable | None
) -> Exportable:
    """Return what a run has made, with the words that a caption of its objects holds.

    Words of the weights before are kept where the run was started from those.
    """
    known = () if before is None else before.words
    known = known if run.words[: len(known)] == known else ()
    captions = [make_object(run.config.seed, index).caption for index in range(count)]
    if run.config.meshes is not None:
        captions += MixedSource(run.config.meshes).captions()
    return made.with_words(words_seen(run.words, (*captions, *known)))


def main() -> int:
    """Run from the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    options = tyro.cli(ExportConfig, description=__doc__)
    try:
        run, left_out = export_runs(options)
        losses, shape_losses = measure_export(run, options)
        meshes = trained_meshes(options)
        model, shape_model, config = load_weights(options.out)
    except UserError as error:
        _LOG.error("%s", error)
        return error.exit_code
    packed = options.out / BANK_FILE
    bank = read_bank(packed) if packed.is_file() else None
    text = card(config, model, shape_model, losses, shape_losses, options.history, bank, meshes)
    (options.out / "CARD.md").write_text(text, encoding="utf-8")
    size = sum(path.stat().st_size for path in options.out.iterdir())
    _LOG.info("%s: %.1f MB, %d words", options.out, size / 1e6, len(config.words))
    _LOG.info("words left out: %s", " ".join(sorted(left_out)) or "none")
    return 0


if __name__ == "__main__":
    sys.exit(main())
