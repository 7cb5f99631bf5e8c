import numpy as np
import pytest
import torch

from gscomplete.priors.embedded.text import Tokenizer
from recipes.train_embedded_prior.config import DataConfig, TrainConfig
from recipes.train_embedded_prior.data.dataset import SetMaker, decode_sets, sample_ring
from tests.builders.training import DATA, WORDS, stub_source


def maker(seed=0):
    return SetMaker(stub_source, DATA, Tokenizer(WORDS, 6), 16, seed)


def test_a_set_is_a_function_of_seed_and_index():
    first = maker()
    in_order = [first(k) for k in range(3)]
    alone = maker()(2)
    assert in_order[2].tobytes() == alone.tobytes()
    assert in_order[1].tobytes() != alone.tobytes()
    assert maker(seed=1)(2).tobytes() != alone.tobytes()


def test_decoded_sets_are_what_the_network_takes():
    batch = decode_sets(np.stack([maker()(k) for k in range(3)]))
    assert batch.images.shape == (3, 4, 4, 16, 16)
    assert batch.input_map.shape == (3, 4, 5, 16, 16)
    assert batch.tokens.shape == (3, 6)
    alpha = (batch.images[:, :, 3] + 1) / 2
    color = (batch.images[:, :, :3] + 1) / 2
    assert (color <= alpha[:, :, None] + 1 / 255).all()
    assert 0.05 < float(alpha.mean()) < 0.6
    seen = batch.input_map[:, :, 3]
    assert float(seen.mean()) < float(alpha.mean())  # P is a part
    relief = batch.input_map[:, :, 4]
    assert not relief[seen == 0].any()
    assert float(relief.abs().max()) <= 1
    assert float(relief.max()) > 0.2  # the near side stands out
    assert batch.shape_map.shape == (3, 4, 2, 16, 16)
    # cells that hold splats: the silhouette, a cell (a third of a pixel) fatter at most, with holes
    shape = batch.shape_map[:, :, 0]
    assert float((shape - alpha).clamp_min(0).mean()) < 0.05 * float(shape.mean())
    assert float(batch.shape_map[:, :, 1].max()) > 0.2


def test_rings_stay_within_the_framing():
    data = DataConfig()
    views = data.views(64)
    low, high = views.radius_range()
    rings = []
    for index in range(300):
        cameras, ring = sample_ring(data, np.random.default_rng(index))
        rings.append(ring)
        assert len(cameras) == 4
    rings = np.stack(rings)
    assert (rings[:, 0] >= views.elevation_range_deg[0]).all()
    assert (rings[:, 0] <= views.elevation_range_deg[1]).all()
    assert ((rings[:, 1] >= low - 1e-5) & (rings[:, 1] <= high + 1e-5)).all()
    assert 0.6 < ((rings[:, 0] >= 0) & (rings[:, 0] <= 30)).mean() < 0.95


def test_corrupt_share_is_respected():
    flags = []

    def source(seed, index):
        item = stub_source(seed, index)

        def partial(*, disturb, slight):
            assert not slight
            flags.append(disturb)
            return item.splats

        return type(item)(item.splats, item.caption, partial)

    make = SetMaker(source, DATA, Tokenizer(WORDS, 6), 16, 0)
    for k in range(40):
        make(k)
    assert 8 < sum(flags) < 32


@pytest.mark.parametrize(
    "changes",
    [{"minutes": 5.0, "steps": 5}, {"minutes": None, "steps": None}, {"batch_sets": 3}],
)
def test_senseless_runs_are_refused(tmp_path, changes):
    with pytest.raises(ValueError, match="TrainConfig"):
        TrainConfig(out=tmp_path, **changes)


def test_stored_bytes_are_exact_for_nothing_and_everything():
    stored = maker()(0)
    stored["images"][:] = 0
    stored["input_map"][:, :4] = 255
    stored["input_map"][:, 4] = 127
    stored["shape_map"][:, 0] = 255
    stored["shape_map"][:, 1] = 127
    batch = decode_sets(stored[None])
    assert torch.equal(batch.images, torch.full_like(batch.images, -1))
    assert torch.equal(batch.input_map[:, :, :4], torch.ones(1, 4, 4, 16, 16))
    assert not batch.input_map[:, :, 4].any()
    assert torch.equal(batch.shape_map[:, :, 0], torch.ones(1, 4, 16, 16))
    assert not batch.shape_map[:, :, 1].any()
