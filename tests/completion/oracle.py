"""A prior that knows the answer: it denoises every view to a render of a known whole object."""

import torch

from gscomplete.priors.base import FourViews, Guidance, PriorViews
from gscomplete.render import render
from gscomplete.splats import Splats, colors_to_sh


class OracleConditioning:
    report = ("the oracle needs no prompt",)


class OraclePrior:
    name = "oracle"
    sees_input = False
    num_timesteps = 1000
    views = PriorViews(40.0, (1.4, 1.8), (-5.0, 30.0), 32)

    def __init__(self, truth: Splats, poison_step: int | None = None, poison: str = "loss") -> None:
        """From call ``poison_step`` on, poison: a NaN ``loss``, ``gradient`` or ``target``, or a
        gradient that float32 cannot square (``huge``).
        """
        self.truth = truth
        self.poison = poison
        self.guidance_seen: Guidance | None = None
        self._calls_left = poison_step

    def default_guidance(self, *, sees_input):
        return Guidance(text_scale=9.0, rescale=0.25)

    def condition(self, prompt, negative_prompt=None):
        return OracleConditioning()

    def distill(
        self, views: FourViews, timestep, conditioning, generator, input_views=None, guidance=None
    ):
        self.guidance_seen = guidance
        if self._spoilt():
            if self.poison == "loss":
                return views.color.sum() * torch.nan
            views.color.register_hook(
                lambda grad: grad * torch.nan if self.poison == "gradient" else grad + 1e25
            )
        with torch.no_grad():
            truth = render(self.truth, views.cameras)
        color, alpha = views.color - truth.color, views.alpha - truth.alpha
        return 0.5 * (color.square().sum() + alpha.square().sum()) / 4

    def reconstruct(
        self, views, timestep, conditioning, generator, input_views=None, guidance=None, num_steps=8
    ):
        truth = render(self.truth, views.cameras)
        if self._spoilt():
            truth.color[0, 3, 3] = torch.nan
        return truth.color, truth.alpha

    def _spoilt(self) -> bool:
        if self._calls_left is not None:
            self._calls_left -= 1
        return self._calls_left is not None and self._calls_left < 0


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
