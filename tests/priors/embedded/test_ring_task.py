import pytest
import torch

from gscomplete.priors.base import Guidance
from gscomplete.priors.embedded.conditioning import EmbeddedConditioning
from gscomplete.priors.embedded.model import INPUT_CHANNELS, VIEWS
from gscomplete.priors.embedded.ring_task import RingTask

SIDE = 8
WORDS = EmbeddedConditioning(
    torch.tensor([5, 0]), torch.tensor([0, 0]), torch.tensor([5, 0]), (), "a mug"
)


class Network:
    """Says that all is noise, and keeps what it was given."""

    def __init__(self):
        self.given = []

    def __call__(self, x_t, maps, shape, at, ring, tokens):
        self.given.append((maps, tokens))
        return -9.0 * torch.ones_like(x_t)


def task(mapped, guidance):
    return RingTask(torch.ones(3), mapped, torch.zeros(VIEWS, 2, SIDE, SIDE), WORDS, guidance)


@pytest.mark.parametrize("is_withheld", [True, False])
def test_p_is_nothing_where_it_is_withheld(is_withheld):
    seen = torch.full((VIEWS, INPUT_CHANNELS, SIDE, SIDE), 0.5)
    network = Network()
    asked = task(None if is_withheld else seen, Guidance(1.0, 1.0, 0.0))
    x0 = asked.denoise(network, torch.zeros(VIEWS, 4, SIDE, SIDE), 500.0)
    maps = torch.cat([maps for maps, _ in network.given])
    assert float(maps.max()) == (0.0 if is_withheld else 0.5)
    assert x0.shape == (VIEWS, 4, SIDE, SIDE)
    assert float(x0.abs().max()) <= 1.0


def test_guidance_by_text_asks_for_no_text_too():
    network = Network()
    task(None, Guidance(3.0, 1.0, 0.0)).denoise(network, torch.zeros(VIEWS, 4, SIDE, SIDE), 500.0)
    tokens = torch.cat([tokens for _, tokens in network.given]).tolist()
    assert sorted(tokens) == [[0, 0], [5, 0]]
