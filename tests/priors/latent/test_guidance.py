import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from gscomplete.priors.latent.guidance import (
    NoiseSchedule,
    epsilon_loss,
    guided_noise,
    rescaled,
    x0_loss,
)

SCHEDULE = NoiseSchedule.stable_diffusion()
TIMESTEPS = st.integers(0, 999)


def randn(*shape, seed=0, dtype=torch.float64):
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def test_schedule_is_stable_diffusion_s():
    """Values of the specification; a schedule linear in beta is off by up to 0.135."""
    for timestep, alpha_bar in (
        (0, 0.999150),
        (20, 0.981314),
        (500, 0.276333),
        (980, 0.005844),
        (999, 0.004660),
    ):
        assert SCHEDULE.alphas_bar[timestep] == pytest.approx(alpha_bar, abs=6e-7)
    assert len(SCHEDULE) == 1000
    for timestep, ratio in ((980, 13.04), (500, 1.618), (20, 0.138)):
        a, s = SCHEDULE.scales(timestep)
        assert s / a == pytest.approx(ratio, rel=5e-4)


def test_schedule_agrees_with_diffusers():
    diffusers = pytest.importorskip("diffusers")
    scheduler = diffusers.DDPMScheduler(
        beta_start=0.00085, beta_end=0.012, beta_schedule="scaled_linear"
    )
    theirs = scheduler.alphas_cumprod.double()
    assert (theirs - torch.tensor(SCHEDULE.alphas_bar, dtype=torch.float64)).abs().max() < 1e-6


@given(TIMESTEPS, st.sampled_from(["epsilon", "v_prediction"]))
def test_noise_and_clean_are_inverse(timestep, prediction):
    schedule = NoiseSchedule.stable_diffusion(prediction)
    clean, noise = randn(4, 4, 3, 3, seed=1), randn(4, 4, 3, 3, seed=2)
    noisy = schedule.add_noise(clean, noise, timestep)
    a, s = schedule.scales(timestep)
    output = noise if prediction == "epsilon" else a * noise - s * clean
    found = schedule.noise_of(output, noisy, timestep)
    torch.testing.assert_close(found, noise)
    torch.testing.assert_close(schedule.clean_of(found, noisy, timestep), clean)


@pytest.mark.parametrize("timestep", [20, 500, 980])
def test_gradient_of_the_x0_loss_without_rescaling(timestep):
    """(s/a) (e - n) / B with B images (specification, section 2.3)."""
    latents = randn(4, 4, 5, 5).requires_grad_()
    noise, predicted = randn(4, 4, 5, 5, seed=1), randn(4, 4, 5, 5, seed=2)
    noisy = SCHEDULE.add_noise(latents.detach(), noise, timestep)
    x0_loss(latents, SCHEDULE.clean_of(predicted, noisy, timestep).float()).backward()
    a, s = SCHEDULE.scales(timestep)
    expected = s / a * (predicted - noise) / 4
    torch.testing.assert_close(latents.grad, expected, rtol=1e-4, atol=1e-6 * s / a)


def test_gradient_of_the_epsilon_loss():
    latents = randn(8, 4, 5, 5).requires_grad_()
    noise, predicted = randn(8, 4, 5, 5, seed=1), randn(8, 4, 5, 5, seed=2)
    epsilon_loss(latents, predicted, noise).backward()
    torch.testing.assert_close(latents.grad, (predicted - noise) / 8, rtol=1e-4, atol=1e-6)


def test_guidance_of_one_is_conditional_and_of_zero_unconditional():
    conditional, unconditional = randn(4, 2), randn(4, 2, seed=1)
    torch.testing.assert_close(guided_noise(conditional, unconditional, 1.0), conditional)
    torch.testing.assert_close(guided_noise(conditional, unconditional, 0.0), unconditional)
    expected = unconditional + 50 * (conditional - unconditional)
    assert torch.equal(guided_noise(conditional, unconditional, 50.0), expected)


@pytest.mark.parametrize("group", [1, 4])
def test_rescaling_against_a_plain_loop(group):
    """Unbiased deviation over all views, channels and pixels of a group together."""
    guided, conditional = 7 * randn(8, 4, 3, 3) + 1, randn(8, 4, 3, 3, seed=1)
    found = rescaled(guided, conditional, 0.3, group)
    for start in range(0, 8, group):
        part = slice(start, start + group)
        numbers = [guided[part].flatten().tolist(), conditional[part].flatten().tolist()]
        deviations = []
        for values in numbers:
            mean = math.fsum(values) / len(values)
            square = math.fsum((value - mean) ** 2 for value in values)
            deviations.append(math.sqrt(square / (len(values) - 1)))
        ratio = (deviations[1] + 1e-8) / (deviations[0] + 1e-8)
        expected = 0.3 * ratio * guided[part] + 0.7 * guided[part]
        torch.testing.assert_close(found[part], expected)


def test_rescaling_about_a_background_leaves_the_background_as_it_is():
    """About zero it is pulled to grey, and splats answer with fog."""
    background = torch.full((1, 4, 8, 8), -0.9)
    conditional = background.repeat(4, 1, 1, 1)
    conditional[:, :, 2:5, 2:5] = 0.5
    guided = background + 3.0 * (conditional - background)
    found = rescaled(guided, conditional, 1.0, 4, background)
    torch.testing.assert_close(found, conditional)
    grey = rescaled(guided, conditional, 1.0, 4)
    assert float((grey - conditional)[:, :, 0, 0].abs().min()) > 0.3


def test_full_rescaling_gives_the_conditional_contrast():
    guided, conditional = 50 * randn(4, 4, 8, 8), randn(4, 4, 8, 8, seed=1)
    assert float(rescaled(guided, conditional, 1.0, 4).std()) == pytest.approx(
        float(conditional.std()), rel=1e-6
    )
    assert rescaled(guided, conditional, 0.0, 4) is guided
    flat = torch.zeros(4, 4, 2, 2)
    assert torch.isfinite(rescaled(flat, flat, 0.5, 4)).all()
