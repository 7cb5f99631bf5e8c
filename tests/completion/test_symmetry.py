"""Finding the symmetry of a partial object, and the copy that it gives."""

import sys
from pathlib import Path

import pytest
import torch

from gscomplete.completion.symmetry import best_symmetry, symmetric_splats
from gscomplete.evaluate.metrics import against_truth, preservation
from gscomplete.splats import Splats, concatenate
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.views import ViewDistribution

sys.path.insert(0, str(Path(__file__).parent))
from oracle import ball

VIEWS = ViewDistribution(0.0, 10.0)


def test_half_a_ball_is_completed_by_its_copy():
    truth = ball()
    partial = truth.select(truth.means[:, 0] > 0)
    symmetry = best_symmetry(partial, VIEWS, seed=0)
    assert symmetry is not None
    copy = symmetric_splats(partial, symmetry, 1000, seed=0)
    errors = against_truth(concatenate([partial, copy]), partial, truth, VIEWS.preview_cameras(64))
    assert errors.hidden_iou > 0.9


def test_the_copy_hides_behind_the_partial_object():
    truth = ball()
    partial = truth.select(truth.means[:, 0] > 0)
    symmetry = best_symmetry(partial, VIEWS, seed=0)
    assert symmetry is not None
    whole = concatenate([partial, symmetric_splats(partial, symmetry, 1000, seed=0)])
    views = VIEWS.cameras(VIEWS.low_discrepancy(8), 64)
    assert preservation(whole, partial, views).color < 0.002


@pytest.mark.parametrize("seed", range(4))
def test_copies_have_the_shape_that_the_map_gives_them(seed):
    """The covariance of a copied splat is the map's, also for mirror images."""
    partial = ball(seed=seed)
    partial = partial.select(partial.means[:, seed % 2] > 0)
    symmetry = best_symmetry(partial, ViewDistribution(90.0 * (seed % 2), 10.0), seed)
    assert symmetry is not None
    copy = symmetry.apply(partial)

    def covariance(splats: Splats):
        factor = rotation_matrices(splats.quaternions) * splats.scales[:, None, :]
        return factor @ factor.transpose(1, 2)

    expected = symmetry.matrix @ covariance(partial) @ symmetry.matrix.T
    assert torch.allclose(covariance(copy), expected, atol=1e-6)
    assert torch.allclose(copy.means, partial.means @ symmetry.matrix.T + symmetry.shift)
