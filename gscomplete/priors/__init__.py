"""Priors: models that know what objects look like, behind one interface (``base``)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gscomplete.errors import UserError
from gscomplete.priors.base import Conditioning, FourViews, Guidance, Prior, PriorViews

if TYPE_CHECKING:
    import torch

    from gscomplete.priors.latent.settings import LatentPriorSettings

__all__ = [
    "PRIOR_NAMES",
    "Conditioning",
    "FourViews",
    "Guidance",
    "Prior",
    "PriorViews",
    "load_prior",
]

PRIOR_NAMES = ("embedded", "mvdream")
"""Priors that can be asked for by name."""


def load_prior(
    name_or_path: str,
    device: torch.device | str = "cpu",
    settings: LatentPriorSettings | None = None,
) -> Prior:
    """Load a prior by name, or from a path.

    Args:
        name_or_path: one of ``PRIOR_NAMES``; MVDream's published file; or a folder that holds
            MVDream (diffusers' style or converted), any diffusers text-to-image model, or weights
            of the embedded prior as the training recipe exports them.
        device: where it runs.
        settings: knobs of latent diffusion priors; None = their defaults.

    Raises:
        UserError: there is no such prior, or its weights are missing or damaged.
    """
    path = Path(name_or_path)
    if name_or_path == "embedded" or (path / "model.safetensors").is_file():
        from gscomplete.priors.embedded.prior import load_embedded

        if settings is not None:
            raise UserError("--diffusion.*: the embedded prior has none of these knobs")
        return load_embedded(None if name_or_path == "embedded" else path, device)
    if name_or_path not in PRIOR_NAMES and not path.exists():
        raise UserError(
            f"--prior: expected {', '.join(PRIOR_NAMES)}, or a file or folder of weights, found "
            f"{name_or_path!r}"
        )
    from gscomplete.priors.mvdream.store import find_mvdream
    from gscomplete.priors.mvdream.weights import is_mvdream_folder

    if name_or_path == "mvdream" or path.is_file() or is_mvdream_folder(path):
        from gscomplete.priors.mvdream.prior import load_mvdream

        return load_mvdream(find_mvdream() if name_or_path == "mvdream" else path, device, settings)
    from gscomplete.priors.diffusers_2d import is_diffusers_folder, load_diffusers_2d

    if is_diffusers_folder(path):
        return load_diffusers_2d(path, device, settings)
    raise UserError(
        f"--prior {name_or_path}: expected a folder with weights of the embedded prior "
        "(model.safetensors, config.json), of MVDream, or of a diffusers text-to-image model "
        "(model_index.json), found none of them"
    )
