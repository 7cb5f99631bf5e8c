import torch

from gscomplete.priors.embedded.shape.choice import CANDIDATES, answered_worth, choose_symmetries
from gscomplete.priors.embedded.shape.grid import CELLS, COARSE_CELLS
from gscomplete.priors.embedded.shape.inputs import SOURCES, look_at
from gscomplete.priors.embedded.shape.model import ShapeOutput
from gscomplete.views import ViewDistribution
from tests.priors.embedded.shape.shapes import half, mirrors, sphere

LOOK = look_at(half(sphere()), ViewDistribution(0.0, 10.0))


class Believer(torch.nn.Module):
    """Fills P and, of the copies shown first, those that reach far behind P."""

    def forward(self, volumes, evidence, scores, tokens):
        assert volumes.shape[0] == evidence.shape[0] == scores.shape[0] == tokens.shape[0]
        filled = volumes[:, 0, 0] > 0
        copy = volumes[:, 1, 0] > 0
        trusted = copy[:, : CELLS // 4].any(dim=(1, 2, 3))[:, None, None, None]
        filled = filled | (copy & trusted)
        n = COARSE_CELLS
        nothing = torch.zeros(len(volumes), SOURCES + 1, n, n, n)
        return ShapeOutput(16.0 * filled.float() - 8.0, nothing[:, :3], nothing)


def test_a_copy_the_answer_fills_is_worth_more_than_one_it_leaves_empty():
    seen = LOOK.with_copies(mirrors())
    partial, across, along = (torch.from_numpy(seen.volumes[k, 0]) for k in range(3))
    whole = ((partial > 0) | (across > 0)).float()
    assert answered_worth(whole, across, partial) > 0.95
    assert abs(answered_worth(whole, along, partial)) < 0.1  # it shows nothing new
    alone = (partial > 0).float()
    assert answered_worth(alone, across, partial) < -0.2


def test_the_copies_that_answers_bear_out_are_shown():
    tokens = torch.zeros(4, dtype=torch.long)
    planes = LOOK.candidates(CANDIDATES)
    chosen = choose_symmetries(Believer(), LOOK, tokens)
    assert len(chosen) == SOURCES - 1
    places = {plane.shift.tobytes() + plane.matrix.tobytes() for plane in planes}
    among = [plane.shift.tobytes() + plane.matrix.tobytes() in places for plane in chosen]
    assert among == [True, True, False]
    farthest = chosen[0].apply(LOOK.positions)[:, 0].min()
    assert farthest < -0.36
    again = choose_symmetries(Believer(), LOOK, tokens)
    assert [c.score for c in chosen] == [c.score for c in again]
