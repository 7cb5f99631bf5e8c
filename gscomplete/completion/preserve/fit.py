"""Rounds of refitting new splats to P's appearance from V, with everything else kept as it was.

Conventions
-----------
* A round has views of V, then views from outside V. Splats that take no part are frozen with P.
* Renders are made over black and compared over the given background; ``before`` is over black.
* Splats may fade, move and shrink. Colours and rotations stay, and scales do not grow: a splat that
  grew to cover an opening would be visible from other directions.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gscomplete.completion.settings import HardPreservationSettings
from gscomplete.evaluate.metrics import NOTHING_ALPHA
from gscomplete.fitting.row_adam import RowAdam
from gscomplete.render import PreparedFrozen, Render, join_prepared, render
from gscomplete.splats import Splats
from gscomplete.util.same_bits import fixed_mean, fixed_sigmoid, fixed_sum
from gscomplete.views import Cameras, ViewDistribution
from gscomplete.views.distribution import MAX_ELEVATION_DEG

MARGIN = 0.8
"""The aim for errors over the check views is this share of the bounds, so that other views of V are
within the bounds too."""
_OUTSIDE_VIEWS = 8
"""Views from outside V whose pictures are kept."""
_OUTSIDE_RISE_DEG = 25.0
"""Every other view from outside V looks from this much higher."""
_FAR_ABOVE = 2.0
"""Errors above this multiple of the aim leave nearly all of the work to fading."""
_VIEWS_PER_STEP = 2
"""Views of V, and as many from outside V, of one step."""
_OPACITY_RATE = 0.3
"""Adam's step size for logits of opacities."""
_MEANS_RATE = 3e-3
"""Adam's step size for positions, in object sizes."""
_SCALES_RATE = 0.02
"""Adam's step size for logarithms of scales; no scale grows."""
_KEEP_WEIGHT = 1.0
"""Weight of what changes in the pictures from outside V and beside P; more keeps the completion
better and takes more rounds."""


def masked_errors(
    completed: Render, partial: Render, mask_from: float = 0.0
) -> tuple[Tensor, Tensor]:  # [], []
    """Return E_color and E_depth with graph, as ``metrics.preservation_of_renders`` defines them.

    O contains P here, so it shows something wherever P does. Pixels where P's alpha is below
    ``mask_from`` add nothing to the errors.
    """
    total = fixed_sum(partial.alpha).clamp_min(1e-12)
    mask = torch.where(partial.alpha >= mask_from, partial.alpha, 0.0)
    color = (completed.color - partial.color).square().mean(dim=-1)
    covered = mask >= NOTHING_ALPHA
    depth = torch.where(covered, completed.depth - partial.depth, 0.0).square()
    return fixed_sum(mask * color) / total, fixed_sum(mask * depth) / total


def relative_error(
    drawn: Render, target: Render, watched: Collection[str], settings: HardPreservationSettings
) -> Tensor:  # []
    """Return the sum of the watched errors ("color", "depth"), each in units of its aim."""
    color, depth = masked_errors(drawn, target, settings.mask_from)
    terms = {
        "color": color / (MARGIN * settings.color_bound),
        "depth": depth / (MARGIN * settings.depth_bound),
    }
    return torch.stack([terms[name] for name in watched]).sum()


@dataclass(frozen=True, slots=True)
class RoundProblem:
    """The views of one round: first those of V, then those from outside."""

    frozen: PreparedFrozen
    """P and the new splats that take no part."""
    before: Render
    """The completion before anything was changed, over black."""
    target: Render
    """P alone from the views of V, over the background."""
    background: Tensor  # [3]
    watched: tuple[str, ...]
    """Errors that take part."""

    def draw(self, generator: torch.Generator, count: int) -> tuple[Tensor, Tensor]:
        """Draw at most ``count`` views from within V and as many from outside."""
        within = len(self.target.alpha)
        inside = torch.randperm(within, generator=generator)[:count].sort().values
        outside = torch.randperm(len(self.frozen) - within, generator=generator)[:count]
        return inside, within + outside.sort().values

    def inside(self, drawn: Render, views: Tensor) -> tuple[Render, Render]:
        """Return the renders from within V over the background, and P's."""
        count = len(views)
        within = Render(drawn.color[:count], drawn.alpha[:count], drawn.depth[:count])
        target = self.target
        return (
            within.over(self.background),
            Render(target.color[views], target.alpha[views], target.depth[views]),
        )

    def change(self, drawn: Render, views: Tensor) -> Tensor:  # []
        """Return the mean squared change of colour and alpha where P is not to be kept."""
        within = len(self.target.alpha)
        color = (drawn.color - self.before.color[views]).square().mean(dim=-1)
        change = color + (drawn.alpha - self.before.alpha[views]).square()
        open_ = torch.ones_like(change)
        inside = views[views < within]
        open_[: len(inside)] = 1.0 - self.target.alpha[inside]
        return fixed_mean(open_ * change)


def are_promising(largest: Sequence[float], rounds: int) -> bool:
    """Say whether further rounds will bring the errors near the bounds, judging by the last two.

    Args:
        largest: the largest error before each round so far and before the next, in units of its
            aim.
        rounds: most rounds.
    """
    done = len(largest) - 1
    if done < 2:
        return True
    of_one_round = math.sqrt(largest[-1] / largest[-3])
    return bool(largest[-1] * of_one_round ** (rounds - done) <= _FAR_ABOVE)


def fit_round(
    splats: Splats,
    problem: RoundProblem,
    settings: HardPreservationSettings,
    weight: float,
    generator: torch.Generator,
) -> Splats:
    """Take the steps of one round.

    Args:
        splats: those that take part.
        problem: the views and what they are to look like.
        settings: bounds and knobs.
        weight: of the errors, against that of the change, which is in units of the colour bound.
        generator: picks the views of each step.
    """
    logits = torch.logit(splats.opacities.clamp(1e-4, 0.999)).requires_grad_()
    means = splats.means.clone().requires_grad_()
    largest = splats.scales.log()
    log_scales = largest.clone().requires_grad_()
    adam = RowAdam(
        {"opacity_logits": logits, "means": means, "log_scales": log_scales},
        {
            "opacity_logits": _OPACITY_RATE,
            "means": _MEANS_RATE,
            "log_scales": _SCALES_RATE,
        },
    )
    for _ in range(settings.steps):
        moving = dataclasses.replace(
            splats, means=means, scales=log_scales.exp(), opacities=fixed_sigmoid(logits)
        )
        inside, outside = problem.draw(generator, _VIEWS_PER_STEP)
        picked = torch.cat([inside, outside])
        frozen = join_prepared([problem.frozen[view] for view in picked.tolist()])
        drawn = render(moving, frozen.cameras, frozen=frozen)
        change = problem.change(drawn, picked)
        error = relative_error(*problem.inside(drawn, inside), problem.watched, settings)
        loss = weight * error + _KEEP_WEIGHT / settings.color_bound * change
        loss.backward()
        adam.step()
        with torch.no_grad():
            log_scales.clamp_max_(largest)
            logits.clamp_(-12.0, 7.0)
    return dataclasses.replace(
        splats,
        means=means.detach(),
        scales=log_scales.detach().exp(),
        opacities=fixed_sigmoid(logits.detach()),
    )


def outside_cameras(distribution: ViewDistribution, size_px: int) -> Cameras | None:
    """Place views evenly over the azimuths that V leaves out; None if V goes all round."""
    gap_deg = 360.0 - 2.0 * distribution.azimuth_range_deg
    if gap_deg <= 0.0:
        return None
    steps = (np.arange(_OUTSIDE_VIEWS) + 0.5) / _OUTSIDE_VIEWS
    azimuths = distribution.azimuth_deg + distribution.azimuth_range_deg + gap_deg * steps
    rise = _OUTSIDE_RISE_DEG * (np.arange(_OUTSIDE_VIEWS) % 2)
    elevations = np.clip(distribution.elevation_deg + rise, -MAX_ELEVATION_DEG, MAX_ELEVATION_DEG)
    return distribution.cameras((azimuths, elevations), size_px)
