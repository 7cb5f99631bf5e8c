"""Priors: models that know what objects look like, behind one interface (``base``)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gscomplete.errors import UserError
from gscomplete.priors.base import Conditioning, FourViews, Guidance, Prior, PriorViews

if TYPE_CHECKING:
    import torch

__all__ = [
    "PRIOR_NAMES",
    "Conditioning",
    "FourViews",
    "Guidance",
    "Prior",
    "PriorViews",
    "load_prior",
]

PRIOR_NAMES = ("embedded",)
"""Priors that can be asked for by name."""


def load_prior(name_or_path: str, device: torch.device | str = "cpu") -> Prior:
    """Load a prior by name, or embedded-prior weights from a folder.

    Args:
        name_or_path: one of ``PRIOR_NAMES``, or a folder with ``model.safetensors`` and
            ``config.json`` as the training recipe exports them.
        device: where it runs.

    Raises:
        UserError: there is no such prior, or its weights are missing or damaged.
    """
    from gscomplete.priors.embedded.prior import load_embedded

    if name_or_path == "embedded":
        return load_embedded(None, device)
    folder = Path(name_or_path)
    if folder.is_dir():
        return load_embedded(folder, device)
    raise UserError(
        f"--prior: expected {' or '.join(PRIOR_NAMES)} or a folder of weights, found "
        f"{name_or_path!r}"
    )
