from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch

from recipes.train_embedded_prior.small_networks import array_sets
from recipes.train_embedded_prior.small_networks.array_sets import stem_of
from recipes.train_embedded_prior.small_networks.object_tasks import (
    ObjectTask,
    object_tasks,
    sets_of_objects,
    train_entries,
)
from recipes.train_embedded_prior.small_networks.outline_sets import OutlineSets
from recipes.train_embedded_prior.small_networks.perceptron_training import PerceptronConfig
from tests.builders.mesh_pack import write_pack


def test_objects_are_those_of_the_train_split_in_an_order_of_the_seed(tmp_path):
    pack = write_pack(tmp_path)
    entries = train_entries(pack, 3, 100)
    assert {entry.split for entry in entries} == {"train"}
    assert entries == train_entries(pack, 3, 100)
    assert [task.entry for task in object_tasks(pack, 3, 1)] == entries[:1]
    orders = {tuple(e.id for e in train_entries(pack, seed, 100)) for seed in range(8)}
    assert len(orders) == 2


def test_an_object_and_its_parts_are_a_function_of_the_seeds(tmp_path):
    pack = write_pack(tmp_path)
    task = ObjectTask(pack, train_entries(pack, 3, 1)[0], 3)
    one, same, other = (task.turned(*seeds) for seeds in ((3,), (3,), (3, 1)))
    assert torch.equal(one.complete.means, same.complete.means)
    assert not torch.equal(one.complete.means, other.complete.means)
    part, again = one.part("half"), same.part("half")
    assert torch.equal(part.means, again.means)
    framed = one.framed(part, "half")
    assert framed is not None
    assert framed.item.prompt == task.entry.caption
    assert one.framed(part.select(torch.arange(0)), "half") is None


def _never(task):
    raise AssertionError("made before")


def _row(task):
    return OutlineSets(*(np.full((1,), task.entry.number, np.float32) for _ in range(3)))


def test_files_are_made_once_and_other_contents_are_other_files(tmp_path, monkeypatch):
    pack, run = write_pack(tmp_path), tmp_path / "run"
    config = PerceptronConfig(pack, run, run / "x", 2, 3, 16, 1, 1, 0.0, workers=1)
    made = sets_of_objects(config, OutlineSets, "rows", "a", _row, 1)
    numbers = [task.entry.number for task in object_tasks(pack, 3, 2)]
    assert [float(sets.kinds[0]) for sets in made] == [np.float32(n) for n in numbers]
    again = sets_of_objects(config, OutlineSets, "rows", "a", _never, 1)
    assert [sets.kinds.tolist() for sets in again] == [sets.kinds.tolist() for sets in made]
    threads = lambda workers, mp_context: ThreadPoolExecutor(workers)  # noqa: E731
    monkeypatch.setattr(array_sets, "ProcessPoolExecutor", threads)  # processes are tested above
    assert len(sets_of_objects(config, OutlineSets, "rows", "b", _row, 1, share=0.5)) == 1
    stems = {stem_of(run, "rows", f"3 {contents}").name for contents in "ab"}
    assert {file.name.rsplit("-", 1)[0] for file in run.iterdir()} == stems
