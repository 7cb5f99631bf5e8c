"""Hidden surfaces: known answers, a second computation, and no dependence on order or density."""

import numpy as np
import pytest
import torch

from gscomplete.evaluate.geometry import OWN, hidden_surface_errors
from gscomplete.splats import Splats, concatenate
from tests.builders.objects import round_splats


def sheet(x0: float, x1: float, z: float = 0.0, step: float = 0.01, opacity: float = 0.9) -> Splats:
    """Flat splats on a square grid in a plane, offset by half a step from the cells' borders."""
    xs = np.arange(round(x0 / step), round(x1 / step)) * step + step / 4
    x, y = np.meshgrid(xs, np.arange(30) * step + step / 4, indexing="ij")
    means = torch.tensor(np.stack([x, y, np.full_like(x, z)], -1).reshape(-1, 3)).float()
    return round_splats(means, scale=0.01, opacity=opacity)


def test_the_truth_itself_is_perfect():
    partial, truth = sheet(0, 0.2), sheet(0, 0.4)
    found = hidden_surface_errors(truth, partial, truth)
    assert found is not None
    assert (found.chamfer, found.f_score_1, found.f_score_3) == (0.0, 1.0, 1.0)
    # One of the 40 columns of splats is next to P's and does not count as hidden.
    assert found.hidden_share == pytest.approx(0.2 / 0.4, abs=1.5 / 40)


def test_nothing_new_scores_nothing_and_a_lifted_copy_its_height():
    partial, truth = sheet(0, 0.2), sheet(0, 0.4)
    alone = hidden_surface_errors(partial, partial, truth)
    assert alone is not None
    assert (alone.chamfer, alone.f_score_1) == (None, 0.0)
    lifted = hidden_surface_errors(concatenate([partial, sheet(0.22, 0.4, 0.02)]), partial, truth)
    assert lifted is not None
    assert lifted.chamfer == pytest.approx(0.02, rel=0.02)  # nearer to P only at the border
    assert lifted.f_score_1 < 0.05
    assert lifted.f_score_3 == 1.0


def test_a_second_computation_agrees():
    """Distances by brute force over the splats' centres: each is alone in its cell here."""
    partial, truth = sheet(0, 0.2), sheet(0, 0.4)
    completed = concatenate([partial, sheet(0.25, 0.45, 0.012)])
    found = hidden_surface_errors(completed, partial, truth)
    p, t, o = (s.means.double().numpy() for s in (partial, truth, completed))

    def nearest(a, b):
        return np.sqrt(((a[:, None] - b[None]) ** 2).sum(-1)).min(1)

    hidden, new = t[nearest(t, p) > OWN], o[nearest(o, p) > OWN]
    reach, excess = nearest(hidden, np.concatenate([p, new])), nearest(new, t)
    assert found is not None
    assert found.chamfer == pytest.approx(0.5 * (reach.mean() + excess.mean()), rel=1e-6)
    recall, precision = (reach < 0.03).mean(), (excess < 0.03).mean()
    expected = 2 * recall * precision / (recall + precision)
    assert found.f_score_3 == pytest.approx(expected, rel=1e-6)


def test_order_repeats_and_faint_splats_do_not_count():
    partial, truth = sheet(0, 0.2), sheet(0, 0.4)
    completed = concatenate([partial, sheet(0.25, 0.45, 0.012)])
    expected = hidden_surface_errors(completed, partial, truth)
    turned = torch.randperm(len(completed), generator=torch.Generator().manual_seed(1))
    crowded = concatenate(
        [completed.select(turned), sheet(0.25, 0.35, 0.012), sheet(0, 0.4, 0.3, opacity=0.1)]
    )
    found = hidden_surface_errors(crowded, partial, truth)
    assert found is not None
    assert expected is not None
    assert found.chamfer == pytest.approx(expected.chamfer, rel=1e-9)
    assert (found.f_score_1, found.f_score_3) == (expected.f_score_1, expected.f_score_3)


def test_a_part_that_shows_everything_hides_nothing():
    truth = sheet(0, 0.4)
    assert hidden_surface_errors(truth, truth, truth) is None
