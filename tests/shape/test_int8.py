"""The shape network in 8 bits against the same one in float32."""

import pytest
import torch

from gscomplete.networks.precision import multiplies_bytes
from gscomplete.priors.embedded.weights import packaged_weights, read_weights
from gscomplete.shape.ask import ask
from gscomplete.shape.int8 import ByteShapeCompleter
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half
from tests.builders.shape_network import likeliest_inputs, tiny_network
from tests.builders.threads import each_thread_count

pytestmark = pytest.mark.skipif(
    not multiplies_bytes(), reason="the processor does not multiply bytes itself"
)
TOKENS = torch.tensor([2, 3])


@pytest.mark.parametrize("bfloat16", [False, True])
def test_the_packaged_network_in_bytes_is_close_to_float32(bfloat16):
    seen = likeliest_inputs(half(ball()), ViewDistribution(0.0, 10.0))
    stored = read_weights(packaged_weights())
    expected = ask(stored.shape(), seen, TOKENS)
    found = ask(ByteShapeCompleter(stored.shape()), seen, TOKENS, bfloat16=bfloat16)
    error = (found.occupancy - expected.occupancy).square().mean().sqrt()
    assert float(error / expected.occupancy.std()) < 0.04  # measured: 0.01 to 0.026
    filled, meant = found.occupancy > 0, expected.occupancy > 0
    assert float((filled & meant).sum() / (filled | meant).sum()) > 0.98


def test_answers_do_not_depend_on_threads():
    seen, model = likeliest_inputs(half(ball()), ViewDistribution(0.0, 10.0)), tiny_network()
    fast = ByteShapeCompleter(model)
    one, *others = (ask(fast, seen, TOKENS, bfloat16=True).occupancy for _ in each_thread_count())
    for other in others:
        assert torch.equal(one, other)
