import pytest
import torch

from gscomplete.shape.network import (
    ShapeCompleter,
    fold,
    laid_out,
    unfold,
)
from gscomplete.shape.symmetry import SOURCES
from gscomplete.shape.voxels import CELLS, COARSE_CELLS
from tests.builders.shape_network import TINY, tiny_network
from tests.builders.threads import each_thread_count


@pytest.fixture(scope="module")
def model():
    return tiny_network()


def test_folding_is_undone():
    x = torch.rand(2, 3, 8, 8, 8)
    assert torch.equal(unfold(fold(x)), x)
    # Fine cell (1, 0, 1) of coarse cell (2, 3, 1) is channel 5 of it.
    assert torch.equal(fold(x[:, :1])[0, 5, 2, 3, 1], x[0, 0, 5, 6, 3])


def test_output_has_a_value_for_every_cell_and_reads_the_prompt(model):
    volumes = torch.rand(2, SOURCES, 4, CELLS, CELLS, CELLS)
    evidence = torch.rand(2, 3, COARSE_CELLS, COARSE_CELLS, COARSE_CELLS)
    tokens = torch.tensor([[2, 3], [4, 0]])
    with torch.no_grad():
        out = model(volumes, evidence, torch.zeros(2, SOURCES - 1), tokens)
        other = model(volumes, evidence, torch.zeros(2, SOURCES - 1), tokens.flip(0))
    assert out.occupancy.shape == (2, CELLS, CELLS, CELLS)
    assert out.sources.shape[1] == SOURCES + 1
    assert not torch.equal(out.occupancy, other.occupancy)


@pytest.mark.parametrize("layout", [laid_out, lambda network: network])
def test_answers_in_float32_do_not_depend_on_threads(layout):
    """As processors compute them that do not multiply bytes."""
    generator = torch.Generator().manual_seed(0)
    volumes = torch.rand(1, SOURCES, 4, CELLS, CELLS, CELLS, generator=generator)
    evidence = torch.rand(1, 3, COARSE_CELLS, COARSE_CELLS, COARSE_CELLS, generator=generator)
    words, network, found = torch.tensor([[2, 3]]), layout(tiny_network()), []
    for _ in each_thread_count():
        with torch.no_grad():
            out = network(volumes, evidence, torch.zeros(1, SOURCES - 1), words)
        parts = (out.occupancy, out.colors, out.sources)
        found.append(b"".join(part.contiguous().numpy().tobytes() for part in parts))
    assert len(set(found)) == 1


def test_a_trusted_source_fills_its_own_cells(model):
    """With trust in P alone the answer is P, cell by cell."""
    volumes = (torch.rand(1, SOURCES, 4, CELLS, CELLS, CELLS) > 0.7).float()
    evidence = torch.zeros(1, 3, COARSE_CELLS, COARSE_CELLS, COARSE_CELLS)
    blind = ShapeCompleter(TINY, COARSE_CELLS)
    with torch.no_grad():
        blind.head.bias[:8] = -5.0
        blind.head.bias[-SOURCES] = 10.0
        out = blind(volumes, evidence, torch.zeros(1, SOURCES - 1), torch.zeros(1, 1).long())
    assert torch.equal(out.occupancy > 0, volumes[:, 0, 0] > 0.5)
