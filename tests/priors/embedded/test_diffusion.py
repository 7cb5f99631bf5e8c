import itertools

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.priors.embedded import diffusion as d

TIMES = st.floats(0, 999)


@given(t=TIMES)
@settings(max_examples=50, deadline=None)
def test_conversions_agree_in_float64(t):
    generator = torch.Generator().manual_seed(1)
    x0 = torch.randn(3, 4, dtype=torch.float64, generator=generator)
    noise = torch.randn(3, 4, dtype=torch.float64, generator=generator)
    at = torch.tensor(t, dtype=torch.float64)
    x_t, v = d.add_noise(x0, noise, at), d.velocity(x0, noise, at)
    torch.testing.assert_close(d.x0_from_v(x_t, v, at), x0)


@given(t=TIMES)
@settings(max_examples=50, deadline=None)
def test_schedule_preserves_variance_and_weight_is_bounded(t):
    at = torch.tensor(t, dtype=torch.float64)
    alpha, sigma = d.alpha_sigma(at)
    assert float(alpha**2 + sigma**2) == pytest.approx(1)
    snr = float((alpha / sigma) ** 2)
    assert float(d.loss_weight(at)) == pytest.approx(min(1, d.SNR_CAP / (snr + 1)))


def test_last_timestep_is_pure_noise():
    noise = torch.randn(5, dtype=torch.float64)
    mixed = d.add_noise(torch.full_like(noise, 7), noise, torch.tensor(999.0, dtype=torch.float64))
    torch.testing.assert_close(mixed, noise)


def test_timesteps_broadcast_from_the_left():
    x0, noise = torch.randn(2, 3, 4), torch.randn(2, 3, 4)
    both = d.add_noise(x0, noise, torch.tensor([10.0, 900.0]))
    torch.testing.assert_close(both[1], d.add_noise(x0[1], noise[1], torch.tensor(900.0)))


IMAGES = {
    key: torch.randn(1, 2, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(n))
    for n, key in enumerate(itertools.product([False, True], repeat=2))
}


def full_formula(has_input, has_text, input_scale, text_scale):
    none, seen = IMAGES[False, False], IMAGES[has_input, False]
    told = IMAGES[has_input, has_text]
    return none + input_scale * (seen - none) + text_scale * (told - seen)


@pytest.mark.parametrize("has_input", [False, True])
@pytest.mark.parametrize("has_text", [False, True])
@pytest.mark.parametrize("input_scale", [0.0, 1.0, 2.5])
@pytest.mark.parametrize("text_scale", [0.0, 1.0, 4.0])
def test_skipping_passes_changes_nothing(has_input, has_text, input_scale, text_scale):
    run = []

    def denoise(passes):
        run.extend(passes)
        return [IMAGES[key] for key in passes]

    result = d.guided_x0(
        denoise,
        has_input=has_input,
        has_text=has_text,
        input_scale=input_scale,
        text_scale=text_scale,
    )
    torch.testing.assert_close(result, full_formula(has_input, has_text, input_scale, text_scale))
    assert len(run) == len(set(run))
    if input_scale == text_scale == 1.0:
        assert run == [(has_input, has_text)]


def test_rescale_brings_contrast_back():
    def denoise(passes):
        return [IMAGES[key] for key in passes]

    options = {"has_input": True, "has_text": True, "input_scale": 2.0, "text_scale": 6.0}
    strong = d.guided_x0(denoise, **options)
    tamed = d.guided_x0(denoise, rescale=1.0, **options)
    assert float(tamed.std()) == pytest.approx(float(IMAGES[True, True].std()))
    tamed, strong = tamed - d.TRANSPARENT, strong - d.TRANSPARENT  # what is empty stays empty
    torch.testing.assert_close(tamed / tamed.norm(), strong / strong.norm())
