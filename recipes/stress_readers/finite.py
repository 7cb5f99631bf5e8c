"""Is everything finite that a reader returns?"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import torch

_MISSING_ALLOWED = ("DepthImage",)
"""Of these, NaN says that a value is unknown; infinities say nothing."""


def require_finite(found: Any, name: str = "result", is_missing_allowed: bool = False) -> None:
    """Look through dataclasses, lists, dictionaries, arrays and tensors.

    Raises:
        ValueError: a number is NaN or infinite.
    """
    if isinstance(found, torch.Tensor):
        found = found.detach().cpu().double().numpy() if found.is_floating_point() else None
    if isinstance(found, np.ndarray):
        if found.dtype.kind == "f":
            is_sound = ~np.isinf(found) if is_missing_allowed else np.isfinite(found)
            if not is_sound.all():
                raise ValueError(f"{name}: {int((~is_sound).sum())} numbers are not finite")
    elif isinstance(found, float):
        if not math.isfinite(found):
            raise ValueError(f"{name}: {found} is not finite")
    elif dataclasses.is_dataclass(found) and not isinstance(found, type):
        is_missing_allowed |= type(found).__name__ in _MISSING_ALLOWED
        for field in dataclasses.fields(found):
            require_finite(getattr(found, field.name), f"{name}.{field.name}", is_missing_allowed)
    elif isinstance(found, dict):
        for key, value in found.items():
            require_finite(value, f"{name}.{key}", is_missing_allowed)
    elif isinstance(found, list | tuple):
        for index, value in enumerate(found):
            require_finite(value, f"{name}[{index}]", is_missing_allowed)
