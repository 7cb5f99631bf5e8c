"""Every knob of the training recipe.

Conventions
-----------
* A *set* is one training example: four views of an object, P from the same cameras, ring, words.
* Lengths are in object frame units (the object's largest side is 1); angles in degrees.
* Defaults are those of the shipped weights; their run is described in the weights' CARD.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from gscomplete.priors.base import PriorViews
from gscomplete.priors.embedded.model import ModelConfig
from gscomplete.shape.network import ShapeModelConfig


@dataclass(frozen=True, slots=True)
class DataConfig:
    """How training sets are made. Changing anything here changes the data of every index."""

    fov_deg: float = 40.0
    extent_range: tuple[float, float] = (1.35, 1.9)
    """Visible extent at the target; the camera radius follows from it."""
    elevation_range_deg: tuple[float, float] = (-10.0, 45.0)
    mesh_share: float = 0.7
    """Share of sets made from the pack of meshes, where one is given."""
    render_px: int = 128
    """Side of the renders, area-averaged down to the model's resolution."""

    def views(self, resolution_px: int) -> PriorViews:
        """Return the framing as the prior states it."""
        return PriorViews(self.fov_deg, self.extent_range, self.elevation_range_deg, resolution_px)


@dataclass(frozen=True, slots=True)
class ShapeDataConfig:
    """How sets of the shape network are made. Changing anything changes the data of every index."""

    slight_share: float = 0.25
    """Share of sets whose P lacks little or nothing, as captures from all round do: without them
    completions spoil such parts."""
    mesh_share: float = 0.7
    """Share of sets made from the pack of meshes, where one is given."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """One training run, whatever is trained."""

    out: Path
    """Folder of checkpoints, data shards, log and sample sheets."""
    resume: bool = False
    """Go on from the checkpoint in ``out``; without it ``out`` must hold none."""
    start_from: Path | None = None
    """Folder of exported weights to start a new run from, such as the package's own; None = random
    numbers. Their words keep their places, new ones follow."""
    minutes: float | None = 95.0
    """Length of training in minutes of its own running time; None = set by ``steps``."""
    meshes: Path | None = None
    """Pack of meshes to train on (``mesh_pack``) beside procedural objects; None = none."""
    mesh_count: int | None = None
    """Use only so many meshes of the pack, to measure what more of them gain; None = all."""
    steps: int | None = None
    """Length of training in steps; None = set by ``minutes``. Exactly one of them is given."""
    seed: int = 0
    batch_sets: int = 4
    learning_rate: float = 4e-4
    warmup_steps: int = 200
    decay_share: float = 0.35
    """Share of the run, at its end, over which the learning rate falls linearly to zero."""
    betas: tuple[float, float] = (0.9, 0.98)
    weight_decay: float = 0.01
    ema_decay: float = 0.999
    """Decay per step of the averaged weights, which are the ones shipped; warmed up."""
    drop_text: float = 0.1
    """Share of sets trained without text."""
    precision: Literal["bfloat16", "float32"] = "bfloat16"
    device: str = "cpu"
    replicas: int = 2
    """Trainer processes that share each step's sets; on a CPU, one per core."""
    threads: int = 1
    """Threads of each replica."""
    workers: int = 2
    """Processes that make sets; they yield to the trainer (lowest priority)."""
    nice: int = 0
    """Added to the process priority, so that other work on the machine stays responsive."""
    checkpoint_minutes: float = 5.0
    sample_minutes: float = 15.0
    """Minutes between evaluations, each with a sample sheet."""
    evaluation_sets: int = 12
    shard_sets: int = 32
    """Sets per data file."""

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            ValueError: the length of the run or the number of replicas makes no sense.
        """
        name = type(self).__name__
        if (self.minutes is None) == (self.steps is None):
            raise ValueError(f"{name}: expected exactly one of minutes and steps")
        if self.mesh_count is not None and self.mesh_count < 0:
            raise ValueError(f"{name}: mesh_count: expected 0 or more, found {self.mesh_count}")
        if self.batch_sets % self.replicas != 0:
            raise ValueError(
                f"{name}: expected batch_sets to be a multiple of replicas, found "
                f"{self.batch_sets} and {self.replicas}"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainConfig(RunConfig):
    """Training of the four-view denoiser."""

    drop_input: float = 0.45
    """Share of sets trained with P withheld. At 0.15 the prompt was hardly learned: where P is seen
    there is little left for words to say; but completing P is what the prior is for."""
    drop_shape: float = 0.4
    """Share of sets trained without the object's shape."""
    data: DataConfig = field(default_factory=DataConfig)
    model: ModelConfig = field(default_factory=lambda: ModelConfig())


@dataclass(frozen=True, slots=True, kw_only=True)
class ShapeTrainConfig(RunConfig):
    """Training of the shape network."""

    batch_sets: int = 8
    learning_rate: float = 6e-4
    drop_text: float = 0.3
    """Share of sets trained without text."""
    fresh_sets: int = 4
    """New sets per step; the others of the batch are drawn from those of the last steps, in
    another orientation."""
    replay_shards: int = 60
    """How far back sets are drawn from."""
    data: ShapeDataConfig = field(default_factory=ShapeDataConfig)
    model: ShapeModelConfig = field(default_factory=lambda: ShapeModelConfig(vocabulary_size=1024))
