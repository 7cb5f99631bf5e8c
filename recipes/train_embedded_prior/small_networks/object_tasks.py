"""Objects that perceptrons learn from: the pack's train split, turned; parts and captures of them.

Conventions
-----------
* An object is turned about the up axis and cut by random numbers that depend only on its id and on
  the seeds that are given.
* Parts are framed as a run frames them.
* Captures are trained from photos once and kept for all trainings. Which objects are captured, and
  how, depends only on the pack; a capture is in the frame of ``TurnedObject.complete``.
"""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.priors.embedded.prior import EmbeddedPrior
from gscomplete.priors.embedded.weights import packaged_weights
from gscomplete.splats import Splats, read_splats, write_splats
from recipes.real_objects.captured import captured_part
from recipes.real_objects.compare import FramedObject, frame_object
from recipes.real_objects.load import RealObject
from recipes.real_objects.unseen import PartKind, complete_object, part_of
from recipes.train_embedded_prior.data.mesh_pack import PackEntry, read_manifest, read_mesh
from recipes.train_embedded_prior.small_networks.array_sets import made_of_tasks, stem_of
from recipes.train_embedded_prior.small_networks.perceptron_training import PerceptronConfig

Sets = TypeVar("Sets")
"""A dataclass of arrays that have the same number of rows."""
_CAPTURE_ORDER = 38
"""Seed of the order of objects."""
_CAPTURE_DRAWS = 92
"""Seed of turns and captures, beside the object's id."""


@dataclass(frozen=True, slots=True)
class TurnedObject:
    """A complete object and the random numbers that its parts are drawn with."""

    entry: PackEntry
    complete: Splats
    turn_deg: float
    rng: np.random.Generator

    def part(self, kind: PartKind) -> Splats:
        """Draw a part of this kind."""
        return part_of(self.complete, kind, self.rng, self.turn_deg)

    def framed(self, part: Splats, kind: str) -> FramedObject | None:
        """Frame a part as a run does; None = it is too small to be framed."""
        item = RealObject(self.entry.id, self.entry.caption, "Z", part, self.complete, kind)
        return framed_item(item)


@dataclass(frozen=True, slots=True)
class ObjectTask:
    """One object to make sets of."""

    meshes: Path
    entry: PackEntry
    seed: int

    def turned(self, *seeds: int) -> TurnedObject:
        """Read the object and turn it by a random angle that these seeds decide."""
        rng = np.random.default_rng((self.entry.number, *seeds))
        turn_deg = float(rng.uniform(0, 360))
        complete = complete_object(read_mesh(self.meshes, self.entry), self.entry, turn_deg)
        return TurnedObject(self.entry, complete, turn_deg, rng)


@functools.cache
def packaged_prior() -> EmbeddedPrior:
    """Return the prior that ships with the package; this process then uses one thread."""
    torch.set_num_threads(1)
    return EmbeddedPrior.from_folder(packaged_weights())


def framed_item(item: RealObject) -> FramedObject | None:
    """Frame a part as a run does; None = it is too small to be framed."""
    try:
        return frame_object(item, packaged_prior())
    except UserError:
        return None


def train_entries(meshes: Path, seed: int, count: int) -> list[PackEntry]:
    """Return the first objects of the shuffled train split."""
    entries = [entry for entry in read_manifest(meshes) if entry.split == "train"]
    order = np.random.default_rng(seed).permutation(len(entries))
    return [entries[k] for k in order[:count]]


def object_tasks(meshes: Path, seed: int, count: int) -> list[ObjectTask]:
    """Return the tasks of the first objects of the shuffled train split."""
    return [ObjectTask(meshes, entry, seed) for entry in train_entries(meshes, seed, count)]


def sets_of_objects(
    config: PerceptronConfig,
    kind: type[Sets],
    name: str,
    contents: str,
    make: Callable[[ObjectTask], Sets],
    per_file: int,
    share: float = 1.0,
) -> list[Sets]:
    """Return the sets of every file; make the files that are missing.

    Args:
        config: pack, folder, seed, objects and processes.
        kind: the dataclass.
        name: name that the files start with.
        contents: what else decides what the files hold; other contents get other files.
        make: makes the sets of one object; picklable.
        per_file: number of objects per file.
        share: share of the objects to use; the first ones are taken.
    """
    tasks = object_tasks(config.meshes, config.seed, config.objects)
    stem = stem_of(config.run, name, f"{config.seed} {contents}")
    some = tasks[: math.ceil(share * len(tasks))]
    return made_of_tasks(kind, stem, make, some, per_file, config.workers)


@dataclass(frozen=True)
class CapturesConfig(PerceptronConfig):
    """How a perceptron is trained that learns from captures, too."""

    captures: int = 96
    """Objects of which captures are trained."""
    keep: Path = Path("runs/captures")
    """Folder of captures."""

    def capture_tasks(self) -> list[CaptureTask]:
        """Return the tasks of the captures."""
        tasks = object_tasks(self.meshes, _CAPTURE_ORDER, self.captures)
        return [CaptureTask(task, self.keep) for task in tasks]


@dataclass(frozen=True, slots=True)
class CaptureTask:
    """One object to capture."""

    of: ObjectTask
    folder: Path

    def captured(self) -> tuple[TurnedObject, Splats]:
        """Return the object and its capture, from its file if there is one (else in a minute)."""
        torch.set_num_threads(1)
        turned = self.of.turned(_CAPTURE_DRAWS)
        path = self.folder / f"{turned.entry.id}-{_CAPTURE_DRAWS}.ply"
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_splats(path, captured_part(turned.complete, copy.deepcopy(turned.rng)))
        return turned, read_splats(path).splats
