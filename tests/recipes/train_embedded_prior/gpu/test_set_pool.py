import dataclasses

import numpy as np
import pytest
import torch

from gscomplete.priors.embedded.text import Tokenizer
from recipes.train_embedded_prior.config import ShapeDataConfig
from recipes.train_embedded_prior.data.shape_dataset import (
    ShapeSetMaker,
    decode_sets,
    joined,
    turn_batch,
)
from recipes.train_embedded_prior.gpu.set_pool import ORIENTATIONS, SetPool
from tests.builders.training import WORDS, stub_source


@pytest.fixture(scope="module")
def stored():
    maker = ShapeSetMaker(stub_source, ShapeDataConfig(), Tokenizer(WORDS, 16), 0)
    return np.stack([maker(k) for k in range(3)])


def test_sets_come_out_as_the_processor_unpacks_them(stored):
    pool = SetPool(10, "cpu")
    pool.add(stored[:1])
    drawn = pool.draw(ORIENTATIONS, np.random.default_rng(0))
    plain = decode_sets(stored[:1])
    expected = joined([turn_batch(plain, o % 4, o >= 4) for o in range(ORIENTATIONS)])
    for field in dataclasses.fields(expected):
        assert torch.equal(getattr(drawn, field.name), getattr(expected, field.name)), field.name


def test_new_sets_take_the_place_of_the_oldest(stored):
    pool = SetPool(2, "cpu")
    for k in range(3):
        pool.add(stored[k : k + 1])
    assert (len(pool), pool.added) == (2, 3)
    drawn = pool.draw(4 * ORIENTATIONS, np.random.default_rng(0))
    kept = {row.numpy().tobytes() for row in drawn.scores}
    assert kept == {stored[k]["scores"].tobytes() for k in (1, 2)}
