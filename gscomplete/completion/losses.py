"""The losses of a step that do not belong to a prior.

Conventions
-----------
* Norms are sums over pixels and channels, averaged over views, as the paper's equations write them.
* Every comparison is made over a background drawn at random for the step: a splat that hides in
  the colour of one background shows on the next.
"""

from __future__ import annotations

import torch
from torch import Tensor

from gscomplete.render import Render
from gscomplete.util.same_bits import fixed_sum


def preservation_loss(
    completed: Render, partial: Render, background: Tensor, *, masked: bool
) -> Tensor:  # []
    """L_p = E_c || M_c (r(O, c) - r(P, c)) ||^2 (paper section 3.2), both premultiplied renders.

    Args:
        completed: r(O, c), with graph, over black.
        partial: r(P, c) over black; its alpha is the mask M_c.
        background: [3] colour behind both.
        masked: False sets M_c to one everywhere (the warm-up of section 3.3).
    """
    difference = completed.over(background).color - partial.over(background).color
    if masked:
        difference = difference * partial.alpha[..., None]
    return fixed_sum(difference.square()) / completed.alpha.shape[0]


def fit_loss(
    render: Render, target_color: Tensor, target_alpha: Tensor, background: Tensor
) -> Tensor:  # []
    """Half the squared distance of renders to target views, in colour over a background and alpha.

    Args:
        render: of the current splats, with graph, over black.
        target_color: [V, H, W, 3] premultiplied.
        target_alpha: [V, H, W].
        background: [3].
    """
    target = Render(target_color, target_alpha, render.depth).over(background)
    color = render.over(background).color - target.color
    alpha = render.alpha - target_alpha
    return 0.5 * (fixed_sum(color.square()) + fixed_sum(alpha.square())) / render.alpha.shape[0]


def random_background(generator: torch.Generator) -> Tensor:  # [3]
    """Draw a background colour uniformly."""
    return torch.rand(3, generator=generator)
