"""A denoiser small enough for tests, and a ring of views to show it."""

from __future__ import annotations

import torch

from gscomplete.priors.base import FourViews, PriorViews
from gscomplete.priors.embedded.model import FourViewDenoiser, ModelConfig
from gscomplete.priors.embedded.weights import FORMAT_VERSION, PriorConfig, TrainingRecord
from gscomplete.views.cameras import four_view_orbit

WORDS = ("blue", "chair", "mug", "red")
TINY = ModelConfig(
    resolution_px=16,
    widths=(16, 16, 32),
    blocks=(1, 1, 1),
    transformers=(1, 1),
    head_width=16,
    groups=4,
    embedding=32,
    text_width=16,
    text_length=6,
    vocabulary_size=2 + len(WORDS),
)


def tiny_config() -> PriorConfig:
    return PriorConfig(
        FORMAT_VERSION,
        TINY,
        PriorViews(40.0, (1.35, 1.9), (-10.0, 45.0), TINY.resolution_px),
        WORDS,
        "int8",
        TrainingRecord(steps=1, sets=1, hours=0.0, machine="test", seed=0),
    )


def tiny_model(seed: int = 0) -> FourViewDenoiser:
    """Return a model whose every weight matters (nothing left at its zero initialisation)."""
    torch.manual_seed(seed)
    model = FourViewDenoiser(TINY)
    with torch.no_grad():
        for parameter in model.parameters():
            if parameter.ndim >= 2:
                parameter.add_(0.1 * torch.randn(parameter.shape))
    return model.eval()


def ring_views(
    size_px: int = 32, seed: int = 0, *, azimuth_deg: float = 33.0, elevation_deg: float = 20.0
) -> FourViews:
    """Return four views of noise with valid premultiplied colours."""
    generator = torch.Generator().manual_seed(seed)
    alpha = torch.rand(4, size_px, size_px, generator=generator)
    color = torch.rand(4, size_px, size_px, 3, generator=generator) * alpha[..., None]
    depth = 2.0 + torch.rand(4, size_px, size_px, generator=generator)
    cameras = four_view_orbit(azimuth_deg, elevation_deg, radius=2.2, fov_deg=40.0, size_px=size_px)
    return FourViews(color, alpha, depth, cameras)
