import numpy as np
import pytest

from gscomplete.errors import UserError
from recipes.train_embedded_prior.data.shards import ShardReader, ShardSpec
from tests.builders.training import DATA, WORDS, stub_source


def failing_source(seed, index):
    raise RuntimeError("no object today")


def spec(source=stub_source, **changes):
    options = {"words": WORDS, "text_length": 6, "resolution_px": 16, "seed": 0, "shard_sets": 4}
    return ShardSpec(source, DATA, **(options | changes))


def test_reading_gives_the_sets_and_deletes_what_was_passed(tmp_path):
    made = spec().maker()
    with ShardReader(spec(), tmp_path, workers=0, first=0) as reader:
        for first in range(0, 24, 3):
            read = reader.read(range(first, first + 3))
            expected = np.stack([made(k) for k in range(first, first + 3)])
            assert read.tobytes() == expected.tobytes()
        assert len(list(tmp_path.rglob("*.npy"))) <= 3


def test_folders_of_other_data_do_not_mix():
    assert spec().key() == spec().key()
    assert len({spec().key(), spec(seed=1).key(), spec(words=WORDS[:2]).key()}) == 3


def test_workers_make_the_same_sets_from_the_middle_and_older_ones_that_are_gone(tmp_path):
    """A run resumed without its buffer, or with other data, replays sets of before."""
    with ShardReader(spec(), tmp_path, workers=2, first=16, behind=3) as reader:
        read = reader.read([5, 16, 17])
    made = spec().maker()
    assert read.tobytes() == np.stack([made(k) for k in (5, 16, 17)]).tobytes()


def test_a_dead_worker_is_reported(tmp_path):
    reader = ShardReader(spec(failing_source), tmp_path, workers=1, first=0)
    with reader, pytest.raises(UserError, match="exit code 1"):
        reader.read(range(2))
