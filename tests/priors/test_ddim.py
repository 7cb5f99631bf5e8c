"""DDIM is one loop for schedules of float timesteps (embedded) and of whole ones (latent)."""

import pytest
import torch

from gscomplete.priors.ddim import ddim, even_times
from gscomplete.priors.embedded.diffusion import scales_like
from gscomplete.priors.latent.guidance import NoiseSchedule

CLEAN, NOISE = torch.randn(2, 4, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
STABLE_DIFFUSION = NoiseSchedule.stable_diffusion()


@pytest.mark.parametrize(
    "scales", [scales_like(CLEAN), lambda t: STABLE_DIFFUSION.scales(round(t))]
)
@pytest.mark.parametrize("start", [999.0, 400.0, 3.5])
@pytest.mark.parametrize("steps", [1, 2, 7])
def test_the_way_is_that_of_one_image_and_one_noise(scales, start, steps):
    """With a denoiser that is always right, every noisy image has the first one's noise; float64
    loses at most 1e-16 / sigma = 1e-13 per step where sigma is least (0.0016 at t = 0)."""
    seen = []

    def oracle(noisy, timestep):
        signal, sigma = scales(timestep)
        torch.testing.assert_close(noisy, signal * CLEAN + sigma * NOISE, atol=1e-12, rtol=0)
        seen.append(timestep)
        return CLEAN

    signal, sigma = scales(start)
    times = even_times(start, steps)
    assert ddim(oracle, scales, signal * CLEAN + sigma * NOISE, times) is CLEAN
    assert seen == times
    assert times == sorted(times, reverse=True)
    assert (times[0], len(times)) == (start, steps)


def test_latent_timesteps_are_whole():
    assert STABLE_DIFFUSION.steps(700, 4) == [700, 525, 350, 175]
    assert STABLE_DIFFUSION.steps(10, 3) == [10, 7, 3]


def test_no_steps_are_refused():
    with pytest.raises(ValueError, match="num_steps"):
        even_times(500.0, 0)
