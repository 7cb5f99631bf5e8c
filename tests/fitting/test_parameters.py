"""New splats as parameters: step sizes and bounds."""

import pytest
import torch

from gscomplete.fitting.parameters import BoundedParameters, Bounds
from gscomplete.fitting.settings import LearningRates
from gscomplete.splats import SH_C0, Splats

RATES = LearningRates(means=1e-2, means_final=1e-4, log_scales=0.5, sh=2.0)


def parameters(count: int = 4) -> BoundedParameters:
    base = Splats(
        torch.zeros(count, 3),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1),
        torch.full((count, 3), 0.05),
        torch.full((count,), 0.5),
        torch.zeros(count, 1, 3),
    )
    return BoundedParameters(base, RATES, Bounds(0.04, 0.06))


@pytest.mark.parametrize(("progress", "length"), [(0.0, 1e-2), (0.5, 1e-3), (1.0, 1e-4)])
def test_steps_of_positions_shrink_evenly_on_a_logarithmic_scale(progress, length):
    """Adam's first step is as long as its rate."""
    job = parameters()
    job.splats().means.sum().backward()
    job.step(progress)
    assert job.splats().means.detach().flatten().tolist() == pytest.approx([-length] * 12)


@pytest.mark.parametrize(("sign", "bound"), [(1.0, 0.04), (-1.0, 0.06)])
def test_values_stop_at_their_bounds(sign, bound):
    job = parameters()
    splats = job.splats()
    (sign * (splats.scales.sum() + splats.sh.sum())).backward()
    job.step(0.0)
    assert job.splats().scales.detach().flatten().tolist() == pytest.approx([bound] * 12)
    expected = -sign * 0.5 / SH_C0
    assert job.splats().sh.detach().flatten().tolist() == pytest.approx([expected] * 12)
