"""Priors of known strength answer with the posterior mean of their objects."""

import dataclasses

import pytest
import torch

from gscomplete.priors.base import FourViews, Guidance
from gscomplete.priors.latent.guidance import NoiseSchedule
from gscomplete.render import render
from gscomplete.views import four_view_orbit, radius_to_fit
from recipes.known_priors.priors import SHARPNESS, KnownPrior, blurred
from tests.builders.objects import ball, moved

SIZE_PX = 32
TRUTH = ball(400)
OTHER = moved(TRUTH, (0.3, 0.0, 0.0))
CAMERAS = four_view_orbit(
    20.0, 10.0, radius=radius_to_fit(1.4, 40.0), fov_deg=40.0, size_px=SIZE_PX
)


def views_of(splats):
    return FourViews.from_render(render(splats, CAMERAS), CAMERAS)


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def test_the_exact_prior_has_no_loss_at_the_truth_and_half_the_squared_distance_elsewhere():
    prior = KnownPrior("exact", (TRUTH,), SIZE_PX)
    text = prior.condition("anything")
    assert float(prior.distill(views_of(TRUTH), 500.0, text, generator())) == 0.0
    ours, real = views_of(OTHER), views_of(TRUTH)
    loss = float(prior.distill(ours, 500.0, text, generator()))
    squared = (2 * (ours.color - real.color)).square().sum() + (
        2 * (ours.alpha - real.alpha)
    ).square().sum()
    assert loss == pytest.approx(0.5 * float(squared) / 4, rel=1e-5)  # float32 sums of 16,384
    assert prior.calls == 2


def posterior_mean(objects, renders, noisy, timestep):
    """The slow twin: Bayes' rule in float64 over a list."""
    a, s = NoiseSchedule.stable_diffusion().scales(timestep)
    known = [
        torch.cat([r.color, r.alpha[..., None]], -1).permute(0, 3, 1, 2).double() * 2 - 1
        for r in renders
    ]
    logits = [
        -SHARPNESS * float((noisy.double() - a * k).square().mean()) / (2 * s * s) for k in known
    ]
    weights = torch.softmax(torch.tensor(logits, dtype=torch.float64), 0)
    return sum(w * k for w, k in zip(weights, known, strict=True)), weights


@pytest.mark.parametrize("timestep", [20, 300, 700, 999])
def test_several_objects_are_weighted_by_bayes_rule(timestep):
    objects = (TRUTH, OTHER)
    prior = KnownPrior("plausible", objects, SIZE_PX)
    noise = torch.randn(4, 4, SIZE_PX, SIZE_PX, generator=generator(3))
    renders = [render(splats, CAMERAS) for splats in objects]
    clean = torch.cat([renders[1].color, renders[1].alpha[..., None]], -1).permute(0, 3, 1, 2)
    noisy = NoiseSchedule.stable_diffusion().add_noise(clean * 2 - 1, noise, timestep)
    expected, weights = posterior_mean(objects, renders, noisy, timestep)
    found = prior._denoised(noisy, timestep, CAMERAS, torch.zeros(3), Guidance(), generator())
    assert torch.allclose(found.double(), expected, atol=1e-3)  # softmax of float32 distances
    if timestep <= 300:
        assert float(weights[1]) > 0.99  # follows the render where there is little noise
    if timestep == 999:
        assert 0.3 < float(weights[1]) < 0.7  # averages where there is nothing but noise


def test_reconstruct_returns_valid_renders_of_the_truth():
    prior = KnownPrior("exact", (TRUTH,), SIZE_PX)
    color, alpha = prior.reconstruct(views_of(OTHER), 999.0, prior.condition(""), generator())
    real = views_of(TRUTH)
    assert torch.allclose(alpha, real.alpha, atol=1e-5)
    assert torch.allclose(color, real.color, atol=1e-5)


def test_a_prior_like_mvdream_sees_no_alpha_and_compares_32_by_32():
    prior = KnownPrior("mvdream-like", (TRUTH,), 64)
    drawn = views_of(OTHER)
    images = prior._images(drawn.color, drawn.alpha, torch.ones(3))
    assert images.shape == (4, 3, 32, 32)
    black = dataclasses.replace(drawn, color=torch.zeros_like(drawn.color))
    over_white = prior._images(black.color, black.alpha, torch.ones(3))
    assert float(over_white.amax()) == pytest.approx(1.0)  # nothing of the object: the background


def test_blur_keeps_constants_and_the_mean():
    assert torch.allclose(blurred(torch.ones(1, 4, 9, 9), 2.0), torch.ones(1, 4, 9, 9), atol=1e-6)
    dot = torch.zeros(1, 1, 41, 41)
    dot[0, 0, 20, 20] = 1.0
    wide = blurred(dot, 3.0)
    offset = torch.arange(41.0) - 20
    assert float(wide.sum()) == pytest.approx(1.0, abs=1e-5)
    variance = float((wide.sum(dim=2)[0, 0] * offset.square()).sum())
    assert variance == pytest.approx(9.0, rel=0.05)  # cut off at three standard deviations
