"""Latents are scaled on the way in and back on the way out."""

import pytest
import torch

pytest.importorskip("diffusers", reason="the extra gscomplete[mvdream] is not installed")

from gscomplete.priors.latent.networks import build_vae
from gscomplete.priors.latent.settings import PLANS
from gscomplete.priors.latent.vae import LatentCodec
from tests.builders.tiny_mvdream import TINY


@pytest.mark.parametrize("memory", list(PLANS))
def test_decoding_and_encoding_are_the_networks_but_for_the_scale(memory):
    torch.manual_seed(0)
    vae = build_vae(TINY.vae).eval().requires_grad_(False)
    factor = vae.config.scaling_factor
    assert factor == pytest.approx(0.18215)
    codec = LatentCodec(vae, PLANS[memory], torch.device("cpu"), torch.float32)
    latents = torch.randn(4, 4, 4, 4)
    decoded = vae.decode(latents / factor).sample
    torch.testing.assert_close(codec.decode(latents), decoded, rtol=1e-4, atol=1e-5)
    assert float((decoded - vae.decode(latents).sample).abs().max()) > 0.01
    images = torch.rand(4, 3, 32, 32) * 2 - 1
    expected = factor * vae.encode(images).latent_dist.mean
    torch.testing.assert_close(codec.encode(images, None), expected, rtol=1e-4, atol=1e-5)
