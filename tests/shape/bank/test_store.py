import numpy as np
import pytest

from gscomplete.errors import UserError
from gscomplete.priors.embedded.weights import packaged_weights
from gscomplete.shape.bank.store import (
    BANK_CELLS,
    BANK_FILE,
    ShapeName,
    read_bank,
    write_bank,
)
from tests.builders.known_shapes import box_cells

NAMES = (
    ShapeName("a/chair", "chair", "a red chair with four legs"),
    ShapeName("a/bench", "bench", "a chair for three"),
    ShapeName("b/table", "dining table", "a table"),
    ShapeName("b/red_table", "side table", "a red table"),
    ShapeName("c/sofa", "sofa", "a sofa"),
)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    rng = np.random.default_rng(0)
    path = tmp_path_factory.mktemp("bank") / BANK_FILE
    write_bank(path, NAMES, [rng.random((BANK_CELLS,) * 3) < 0.03 for _ in NAMES])
    return path


def test_surfaces_come_back_bit_by_bit(path):
    bank = read_bank(path)
    rng = np.random.default_rng(0)
    assert bank.names == NAMES
    for index in range(len(bank)):
        assert (bank.surface(index) == (rng.random((BANK_CELLS,) * 3) < 0.03)).all()


def test_shapes_of_the_very_noun_come_before_those_that_are_also_called_so(path):
    bank = read_bank(path)
    assert bank.named("a wooden chair", 9) == [0, 1]
    assert bank.named("two chairs", 1) == [0]
    assert bank.named("a red table with a chair", 9) == [3, 2]
    assert bank.named("two couches", 9) == [4]
    assert bank.named("a unicorn", 9) == []
    assert bank.named("", 9) == []


def test_the_plainest_shape_is_the_noun_with_the_least_beside_it(path):
    bank = read_bank(path)
    assert bank.plainest("a table") == 2  # no side table
    assert bank.plainest("a red side table") == 3
    assert bank.plainest("two chairs") == 0
    assert bank.plainest("a couch") == 4
    assert bank.plainest("a unicorn") is None


def test_the_bank_of_the_package_is_whole_and_free():
    bank = read_bank(packaged_weights() / BANK_FILE)
    assert len(bank) > 2000
    for prompt in ("a chair", "a table", "a bottle", "a box"):
        for index in bank.named(prompt, 3):
            cells = bank.surface(index)
            assert 50 < cells.sum() < cells.size / 2


def test_damage_is_told(path, tmp_path):
    stored = bytearray(path.read_bytes())
    cut = tmp_path / "cut.safetensors"
    cut.write_bytes(stored[:-100])
    with pytest.raises(UserError, match="damage"):
        read_bank(cut)
    stored[-4000:-3000] = bytes(1000)
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(stored)
    bank = read_bank(broken)
    with pytest.raises(UserError, match="c/"):
        bank.surface(len(bank) - 1)


def test_a_shape_that_unpacks_to_another_size_is_refused(tmp_path):
    path = tmp_path / "small.safetensors"
    write_bank(path, NAMES[:1], [box_cells((4, 4, 4), cells=16)])
    with pytest.raises(UserError, match="expected 13824 bytes, found 512"):
        read_bank(path).surface(0)
