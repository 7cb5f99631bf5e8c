"""The losses against their equations, written out by hand."""

import pytest
import torch

from gscomplete.completion.losses import fit_loss, preservation_loss, random_background
from gscomplete.render import Render
from gscomplete.util.randomness import generator_for

BACKGROUND = torch.tensor([0.2, 0.5, 0.9])
VIEWS, SIDE = 2, 5


def random_render(seed: int) -> Render:
    g = torch.Generator().manual_seed(seed)
    return Render(
        torch.rand(VIEWS, SIDE, SIDE, 3, generator=g),
        torch.rand(VIEWS, SIDE, SIDE, generator=g),
        torch.ones(VIEWS, SIDE, SIDE),
    )


def over_background(color: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    return color + (1 - alpha)[..., None] * BACKGROUND


@pytest.mark.parametrize("masked", [True, False])
def test_preservation_loss_is_the_equation(masked):
    completed, partial = random_render(0), random_render(1)
    over_o = over_background(completed.color, completed.alpha)
    over_p = over_background(partial.color, partial.alpha)
    mask = partial.alpha[..., None] if masked else torch.ones(VIEWS, SIDE, SIDE, 1)
    expected = ((mask * (over_o - over_p)) ** 2).sum() / VIEWS
    found = preservation_loss(completed, partial, BACKGROUND, masked=masked)
    torch.testing.assert_close(found, expected)


def test_fit_loss_is_half_the_squared_distance_in_colour_and_alpha():
    drawn, target = random_render(0), random_render(1)
    color = over_background(drawn.color, drawn.alpha) - over_background(target.color, target.alpha)
    expected = 0.5 * ((color**2).sum() + ((drawn.alpha - target.alpha) ** 2).sum()) / VIEWS
    found = fit_loss(drawn, target.color, target.alpha, BACKGROUND)
    torch.testing.assert_close(found, expected)


def test_backgrounds_are_drawn_anew_and_uniformly():
    """300 draws: a uniform channel has mean 0.5 +- 0.017 and deviation 0.289 +- 0.008."""
    drawn = torch.stack([random_background(generator_for(0, s, "background")) for s in range(300)])
    assert drawn.shape == (300, 3)
    assert float(drawn.min()) >= 0
    assert float(drawn.max()) <= 1
    assert ((drawn.mean(dim=0) - 0.5).abs() < 0.08).all()
    assert (drawn.std(dim=0) > 0.25).all()
    assert float((drawn[:, 0] - drawn[:, 1]).abs().mean()) > 0.2  # no grey
