"""Splats as the package gsply takes them, which writes SPZ and compressed PLY."""

from __future__ import annotations

import math
from typing import Any

import torch

from gscomplete.splats.ply_files.records import LOG_SCALE_LIMIT, LOGIT_LIMIT
from gscomplete.splats.record import SH_C0, Splats


def to_gsply(gsply: Any, splats: Splats) -> Any:
    """Turn splats into gsply's container of PLY values.

    Args:
        gsply: the module.
        splats: activated, finite.
    """
    floor = math.exp(LOG_SCALE_LIMIT)
    opacities = splats.opacities.double()
    logits = torch.logit(opacities).clamp(-LOGIT_LIMIT, LOGIT_LIMIT)
    higher = None if splats.sh_degree == 0 else splats.sh[:, 1:].contiguous().numpy()
    return gsply.GSData(
        means=splats.means.numpy(),
        scales=splats.scales.clamp_min(floor).log().numpy(),
        quats=splats.quaternions.numpy(),
        opacities=logits.float().numpy(),
        sh0=((splats.base_colors - 0.5) / SH_C0).contiguous().numpy(),
        shN=higher,
    )
