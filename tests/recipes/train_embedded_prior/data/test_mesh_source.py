import pickle

import numpy as np
import pytest
import torch

from recipes.train_embedded_prior.data.dataset import HELD_OUT_SEED_OFFSET
from recipes.train_embedded_prior.data.mesh_source import MixedSource
from recipes.train_embedded_prior.data.source import frequent_words, procedural_source
from recipes.train_embedded_prior.data.user_parts import user_part
from tests.builders.mesh_pack import write_pack


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_pack(tmp_path_factory.mktemp("meshes") / "pack")


def test_objects_are_a_function_of_seed_and_index(folder):
    source = MixedSource(folder, 1.0)
    first, again = source(3, 5), pickle.loads(pickle.dumps(source))(3, 5)
    assert torch.equal(first.splats.means, again.splats.means)
    assert torch.equal(first.splats.sh, again.splats.sh)
    assert first.caption == again.caption
    low, high = first.splats.means.amin(0), first.splats.means.amax(0)
    assert float((high - low).max()) == pytest.approx(1.0, abs=1e-5)
    assert not torch.equal(source(3, 6).splats.means[:100], first.splats.means[:100])


def test_validation_objects_are_drawn_by_held_out_seeds_only(folder):
    source = MixedSource(folder, 1.0)
    captions = [source(0, k).caption for k in range(12)]  # red of "red box" is a colour, told anew
    assert all(caption.endswith("box") and "picture" not in caption for caption in captions)
    assert any(caption.split()[0] in ("red", "pink", "purple", "orange") for caption in captions)
    held_out = [source(HELD_OUT_SEED_OFFSET, k).caption for k in range(3)]
    assert all(caption.endswith("picture box") for caption in held_out)
    assert set(source.captions()) == {"red box", "plain box"}


def test_the_share_of_meshes_is_kept(folder):
    assert MixedSource(folder, 0.0)(0, 1).caption != ""
    drawn = [MixedSource(folder, 0.5)(0, k).caption.endswith(" box") for k in range(24)]
    assert 4 < sum(drawn) < 20


@pytest.mark.parametrize("disturb", [False, True])
def test_parts_are_parts(folder, disturb):
    splats = MixedSource(folder, 1.0)(0, 0).splats
    shares = []
    for index in range(30):
        part = user_part(splats, 1, index, disturb=disturb, slight=False)
        again = user_part(splats, 1, index, disturb=disturb, slight=False)
        assert torch.equal(part.means, again.means)
        assert torch.isfinite(part.means).all()
        shares.append(len(part) / len(splats))
    assert 0.05 < min(shares) < 0.4
    assert np.median(shares) < 0.8


def test_slight_parts_lack_little(folder):
    splats = MixedSource(folder, 1.0)(0, 0).splats
    parts = [user_part(splats, 1, k, disturb=False, slight=True) for k in range(12)]
    assert np.median([len(part) / len(splats) for part in parts]) > 0.6


def test_words_of_few_captions_are_not_learned():
    captions = ["red mug"] * 5 + ["blue vase"] * 4
    assert frequent_words(captions) == ("mug", "red")


def test_a_run_may_see_some_of_the_meshes_only(folder):
    none, one = MixedSource(folder, 1.0, 0), MixedSource(folder, 1.0, 1)
    assert [none(0, k).caption for k in range(3)] == [
        procedural_source(0, k).caption for k in range(3)
    ]
    assert all(one(0, k).caption.endswith("box") for k in range(6))
    everything = MixedSource(folder, 1.0)
    held_out = HELD_OUT_SEED_OFFSET, 0
    assert none(*held_out).caption == one(*held_out).caption == everything(*held_out).caption
