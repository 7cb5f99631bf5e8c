from dataclasses import dataclass

import numpy as np
import pytest

from recipes.train_embedded_prior.small_networks.array_sets import joined, made_of_tasks, made_once


@dataclass(frozen=True)
class Sets:
    places: np.ndarray
    names: np.ndarray


def sets_from(start: int) -> Sets:
    rows = np.arange(start, start + 3)
    return Sets(np.stack([rows, rows], axis=1), rows.astype(np.int16))


def test_sets_are_put_one_after_the_other():
    both = joined([sets_from(0), sets_from(10)])
    assert both.names.tolist() == [0, 1, 2, 10, 11, 12]
    assert both.places.shape == (6, 2)


def test_what_was_made_is_not_made_again(tmp_path):
    paths = {start: tmp_path / f"sets-{start}.npz" for start in (0, 3, 6)}
    made = []

    def make(pool, start):
        made.append(start)
        if made == [0, 3]:
            raise RuntimeError("cut off")
        return sets_from(start)

    with pytest.raises(RuntimeError, match="cut off"):
        made_once(Sets, paths, make, 1, "sets")
    assert [path.name for path in tmp_path.iterdir()] == ["sets-0.npz"]
    found = made_once(Sets, paths, make, 1, "sets")
    assert made == [0, 3, 3, 6]
    assert [sets.names.tolist() for sets in found] == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    assert found[0].names.dtype == np.int16


def test_tasks_are_put_into_files_in_their_order(tmp_path):
    stem, tasks = tmp_path / "new" / "sets-key", [0, 10, 20]
    found = made_of_tasks(Sets, stem, sets_from, tasks, 2, 1)
    names = sorted(path.name for path in stem.parent.iterdir())
    assert names == ["sets-key-000000.npz", "sets-key-000002.npz"]
    assert [sets.names.tolist() for sets in found] == [[0, 1, 2, 10, 11, 12], [20, 21, 22]]
