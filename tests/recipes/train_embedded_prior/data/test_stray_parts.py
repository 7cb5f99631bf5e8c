import numpy as np
import pytest
import torch

from gscomplete.splats import concatenate
from recipes.train_embedded_prior.data.stray_parts import stray_part
from tests.builders.objects import even_ball, half

WHOLE = even_ball(12_000)
RADIUS = 0.5
PART = half(WHOLE)


def parts(count: int = 40):
    return [stray_part(PART, WHOLE, np.random.default_rng(seed)) for seed in range(count)]


def test_strays_are_what_was_added_off_the_surface():
    shares = []
    for made in parts():
        assert made is not None
        away = (made.splats.means.norm(dim=1) - RADIUS).abs().numpy()
        assert not (made.is_stray & made.is_surface).any()
        # Splats are .016 apart: surface may be .01 from one, and .02 from it is no stray.
        assert (away[made.is_stray] > 0.012).all()
        assert (away[made.is_surface] < 0.04).all()  # noise of .006 at most
        shares.append(made.is_stray.mean())
    assert min(shares) == 0  # some parts get none
    assert 0.01 < np.mean(shares) < 0.2


def test_parts_are_a_function_of_their_random_numbers():
    first, again = parts(5), parts(5)
    for one, other in zip(first, again, strict=True):
        assert torch.equal(one.splats.means, other.splats.means)
        assert torch.equal(one.splats.opacities, other.splats.opacities)
        assert (one.is_stray == other.is_stray).all()
    assert len({len(one.splats) for one in first}) == 5


@pytest.mark.parametrize(("count", "is_enough"), [(299, False), (300, True)])
def test_a_part_of_few_splats_gets_none(count, is_enough):
    some = WHOLE.select(torch.arange(count))
    made = stray_part(some, concatenate([WHOLE]), np.random.default_rng(0))
    assert (made is not None) == is_enough
