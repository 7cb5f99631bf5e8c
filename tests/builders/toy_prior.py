"""A prior in one file, as docs/extending.md says: every object is a grey ball of diameter 0.8."""

import torch

from gscomplete.priors.base import Guidance, PriorViews


class NoText:
    report = ("the toy prior reads no text",)


class BallPrior:
    name = "ball"
    views = PriorViews(40.0, (1.4, 1.8), (-5.0, 30.0), 32)
    sees_input = False
    num_timesteps = 1000

    def default_guidance(self, *, sees_input):
        return Guidance()

    def condition(self, prompt, negative_prompt=None):
        return NoText()

    def _picture(self, cameras):
        """A disc of the ball's apparent radius in the middle of every view."""
        focal, size = float(cameras.focal_px[0, 0]), cameras.width
        distance = float(cameras.positions[0].norm())
        radius_px = focal * 0.4 / (distance**2 - 0.4**2) ** 0.5
        along = torch.arange(size) + 0.5 - size / 2
        alpha = ((along[:, None] ** 2 + along**2).sqrt() < radius_px).float()
        return alpha.expand(len(cameras), -1, -1)

    def distill(self, views, timestep, conditioning, generator, input_views=None, guidance=None):
        alpha = self._picture(views.cameras)
        color = 0.5 * alpha[..., None]
        loss = (views.color - color).square().sum() + (views.alpha - alpha).square().sum()
        return 0.5 * loss / 4

    def reconstruct(
        self,
        views,
        timestep,
        conditioning,
        generator,
        input_views=None,
        guidance=None,
        num_steps=8,
    ):
        alpha = self._picture(views.cameras)
        return 0.5 * alpha[..., None].expand(-1, -1, -1, 3), alpha


def make(device):
    return BallPrior()
