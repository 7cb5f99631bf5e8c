"""The measures of a completion with a prior of known strength.

Conventions
-----------
* Hidden IoU, silhouette IoU and PSNR are those of ``evaluate.metrics``, from 8 views at 256 px,
  against the prior's object with the nearest silhouette, since each of its objects is a right
  answer.
* Fog: alpha farther than ``REACH_PX`` outside that object's silhouette, as a share of the object's
  own area.
* E_color and E_depth are over 16 views of V that nothing was fitted to, at 128 px.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F

from gscomplete.evaluate.metrics import preservation, truth_errors_of_renders
from gscomplete.render import Render, render
from gscomplete.splats import Splats, concatenate
from recipes.known_priors.objects import KnownObject

VIEWS, SIZE_PX = 8, 256
REACH_PX = 4
"""About 1.5 % of the pictures' side."""
_GREY = torch.full((3,), 0.5)


def errors_of(item: KnownObject, new: Splats, believed: tuple[Splats, ...]) -> dict[str, Any]:
    """Measure a completion.

    Args:
        item: the part and its truth.
        new: what was added, object frame.
        believed: the prior's complete objects.
    """
    together = concatenate([item.partial, new.with_sh_degree(0)])
    cameras = item.views.ring(VIEWS, SIZE_PX)
    with torch.no_grad():
        ours, part = (render(splats, cameras, _GREY) for splats in (together, item.partial))
        found = []
        for splats in believed:
            real = render(splats, cameras, _GREY)
            found.append((truth_errors_of_renders(ours, part, real), fog(ours, real)))
    errors, haze = max(found, key=lambda pair: pair[0].silhouette_iou)
    kept = preservation(together, item.partial, item.views.cameras(item.views.measured(16), 128))
    return {
        "silhouette_iou": errors.silhouette_iou,
        "hidden_iou": errors.hidden_iou,
        "hidden_color_psnr_db": errors.hidden_color_psnr_db,
        "fog": haze,
        "e_color_v": kept.color,
        "e_depth_v": kept.depth,
    }


def fog(ours: Render, real: Render) -> float:
    """Return how much alpha stands outside of the real silhouette, over its area."""
    shown = (real.alpha > 1 / 255).float()[:, None]
    near = F.max_pool2d(shown, 2 * REACH_PX + 1, stride=1, padding=REACH_PX)[:, 0] > 0
    outside = torch.where(near, 0.0, ours.alpha.double())
    return float(outside.sum() / real.alpha.double().sum())
