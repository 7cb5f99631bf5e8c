"""Splats of raw parameter values, as checkpoints hold them."""

from __future__ import annotations

import torch
from torch import Tensor

from gscomplete.splats import Splats


def splats_of_state(state: dict[str, Tensor]) -> Splats:
    """Return the activated splats of a completion's checkpoint, in the object frame."""
    value = {name.removeprefix("value."): v for name, v in state.items()}
    return Splats(
        value["means"],
        torch.nn.functional.normalize(value["quaternions"], dim=1),
        value["log_scales"].exp(),
        torch.sigmoid(value["opacity_logits"]),
        value["sh"],
    )
