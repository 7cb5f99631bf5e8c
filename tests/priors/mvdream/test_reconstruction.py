"""The targets of ``LatentPrior.reconstruct``, with a denoiser that knows the clean latents."""

import pytest
import torch

pytest.importorskip("diffusers", reason="the extra gscomplete[mvdream] is not installed")

from gscomplete.priors.base import FourViews, Guidance, PriorViews
from gscomplete.priors.latent.guidance import NoiseSchedule
from gscomplete.priors.latent.prior import (
    LatentConditioning,
    LatentModel,
    LatentPrior,
    PriorIdentity,
)
from gscomplete.priors.latent.settings import PLANS, LatentPriorSettings
from gscomplete.views import four_view_orbit

SCHEDULE = NoiseSchedule.stable_diffusion()
SIZE_PX = 32
CLEAN = torch.randn(4, 4, 4, 4, generator=torch.Generator().manual_seed(1))
CONDITIONING = LatentConditioning(torch.zeros(77, 4), torch.zeros(77, 4), ())


class KnowingDenoiser:
    """Predicts the noise that was added to ``CLEAN`` and remembers what it was given."""

    schedule = SCHEDULE
    group = 4

    def __init__(self) -> None:
        self.shown: list[tuple[int, torch.Tensor]] = []

    def __call__(self, noisy, timestep, context, cameras):
        self.shown.append((timestep, noisy.clone()))
        signal, noise = SCHEDULE.scales(timestep)
        return (noisy - signal * CLEAN) / noise


class ShiftedCodec:
    """Encodes every picture to what is not ``CLEAN``."""

    latent_channels = 4
    downsampling = 8

    def encode(self, images, noise):
        return CLEAN + 1.0

    def decode(self, latents):
        return torch.zeros(4, 3, SIZE_PX, SIZE_PX)


def shown(timestep: float, steps: int) -> list[tuple[int, torch.Tensor]]:
    denoiser = KnowingDenoiser()
    views = PriorViews(40.0, (1.3, 1.6), (0.0, 30.0), SIZE_PX)
    model = LatentModel("knowing", denoiser, ShiftedCodec(), None, views, Guidance())
    plan, device = PLANS["24gb"], torch.device("cpu")
    prior = LatentPrior(model, LatentPriorSettings(), plan, device, PriorIdentity("", {}))
    cameras = four_view_orbit(0.0, 0.0, radius=2.0, fov_deg=40.0, size_px=SIZE_PX)
    empty = torch.zeros(4, SIZE_PX, SIZE_PX)
    views = FourViews(torch.zeros(4, SIZE_PX, SIZE_PX, 3), empty, empty, cameras)
    generator = torch.Generator().manual_seed(0)
    prior.reconstruct(views, timestep, CONDITIONING, generator, num_steps=steps)
    return denoiser.shown


def noise_in(timestep: int, noisy: torch.Tensor, clean: torch.Tensor) -> torch.Tensor:
    signal, noise = SCHEDULE.scales(timestep)
    return (noisy - signal * clean) / noise


def test_every_step_has_the_noise_that_the_one_before_found():
    """Nothing new is drawn on the way (DDIM), so a round is a function of its first noise."""
    steps = shown(700.0, 4)
    assert [timestep for timestep, _ in steps] == [700, 525, 350, 175]
    first = noise_in(*steps[0], CLEAN)
    for timestep, noisy in steps[1:]:
        torch.testing.assert_close(noise_in(timestep, noisy, CLEAN), first, atol=1e-3, rtol=1e-3)


def test_pure_noise_shows_nothing_of_the_renders():
    drawn = noise_in(*shown(998.0, 1)[0], CLEAN + 1.0)
    for timestep in (999.0, 5000.0):
        at, noisy = shown(timestep, 1)[0]
        assert at == 999
        torch.testing.assert_close(noisy, drawn, atol=1e-4, rtol=1e-4)
    with_renders = SCHEDULE.add_noise(CLEAN + 1.0, drawn, 999)
    assert float((with_renders - drawn).abs().max()) > 0.01
