"""A prior that knows the answer and remembers how it was asked, and a small object to know."""

import torch

from gscomplete.priors.base import Guidance
from gscomplete.splats import Splats, colors_to_sh
from recipes.stress_numerics.known_object import KnownObject


class OraclePrior(KnownObject):
    """Asks for guidance of its own and keeps what it was given."""

    name = "oracle"

    guidance_seen: Guidance | None = None

    def default_guidance(self, *, sees_input):
        return Guidance(text_scale=9.0, rescale=0.25)

    def distill(self, views, timestep, conditioning, generator, input_views=None, guidance=None):
        self.guidance_seen = guidance
        return super().distill(views, timestep, conditioning, generator, input_views, guidance)


class GuessingPrior(OraclePrior):
    """Guesses what it was given, if anything."""

    def __init__(self, truth, guess=None):
        super().__init__(truth)
        self.guess = guess

    def first_guess(self, partial, *arguments):
        return self.guess

    def likely_mirrors(self, *arguments):
        return ()


def ball(count: int = 1500, seed: int = 0) -> Splats:
    """A ball of discs, red above and blue below, of diameter 0.8."""
    g = torch.Generator().manual_seed(seed)
    normal = torch.nn.functional.normalize(torch.randn(count, 3, generator=g), dim=1)
    quaternion = torch.cat(
        [1 + normal[:, 2:], -normal[:, 1:2], normal[:, :1], torch.zeros(count, 1)], 1
    )
    top = (normal[:, 2:] > 0).float()
    color = top * torch.tensor([0.9, 0.2, 0.1]) + (1 - top) * torch.tensor([0.1, 0.3, 0.9])
    return Splats(
        0.4 * normal,
        torch.nn.functional.normalize(quaternion + 1e-6, dim=1),
        torch.tensor([[0.03, 0.03, 0.003]]).repeat(count, 1),
        torch.full((count,), 0.95),
        colors_to_sh(color),
    )
