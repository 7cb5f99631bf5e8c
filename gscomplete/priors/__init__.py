"""Priors: models that know what objects look like, behind one interface (``base``)."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gscomplete.errors import UserError

if TYPE_CHECKING:
    import torch

    from gscomplete.priors.base import Conditioning, FourViews, Guidance, Prior, PriorViews
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
_CALLABLE = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
"""``MODULE:FUNCTION``."""
_PARTS = (
    *("name", "views", "sees_input", "num_timesteps", "default_guidance"),
    *("condition", "distill", "reconstruct"),
)
"""Of ``base.Prior``."""


_OF_BASE = ("Conditioning", "FourViews", "Guidance", "Prior", "PriorViews")


def __getattr__(name: str) -> Any:
    """Load the interface on first use (PEP 562): options name priors without PyTorch."""
    if name not in _OF_BASE:
        raise AttributeError(f"module 'gscomplete.priors' has no attribute {name!r}")
    return getattr(importlib.import_module("gscomplete.priors.base"), name)


def load_prior(
    name_or_path: str,
    device: torch.device | str = "cpu",
    settings: LatentPriorSettings | None = None,
) -> Prior:
    """Load a prior by name, or from a path.

    Args:
        name_or_path: one of ``PRIOR_NAMES``; ``MODULE:FUNCTION``, which is imported and called with
            the device, for priors of your own; MVDream's published file; or a folder that holds
            MVDream (diffusers' style or converted), any diffusers text-to-image model, or weights
            of the embedded prior as the training recipe exports them.
        device: where it runs.
        settings: knobs of latent diffusion priors; None = their defaults.

    Returns:
        The prior, on the device.

    Raises:
        UserError: there is no such prior, or its weights are missing or damaged.
    """
    path = Path(name_or_path)
    if _CALLABLE.fullmatch(name_or_path) and not path.exists():
        if settings is not None:
            raise UserError(
                "--diffusion.*: expected a latent diffusion prior, found one of your own"
            )
        return _load_callable(name_or_path, device)
    if name_or_path == "embedded" or (path / "model.safetensors").is_file():
        from gscomplete.priors.embedded.prior import load_embedded

        if settings is not None:
            raise UserError(
                "--diffusion.*: expected a latent diffusion prior, found the embedded one"
            )
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


def _load_callable(name: str, device: torch.device | str) -> Prior:
    """Import a prior of the user's own and make it.

    Raises:
        UserError: there is no such module or function, it takes other arguments than the device,
            or what it returns is no prior.
    """
    module, _, function = name.partition(":")
    try:
        make = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise UserError(
            f"--prior {name}: expected MODULE:FUNCTION, found no such ({error})"
        ) from error
    wanted = "expected a function of one argument, the device"
    if not callable(make):
        raise UserError(f"--prior {name}: {wanted}, found {type(make).__name__}")
    try:
        signature = inspect.signature(make)
    except ValueError:  # some functions written in C have none
        signature = None
    try:
        if signature is not None:
            signature.bind(device)
    except TypeError as error:
        found = f"{function}{signature} ({error})"
        raise UserError(f"--prior {name}: {wanted}, found {found}") from error
    prior: Prior = make(device)
    require_prior(prior, f"--prior {name}")
    return prior


def require_prior(prior: object, what: str) -> None:
    """Check that an object has all that a prior has.

    Args:
        prior: what was given for one.
        what: where it comes from, for the message.

    Raises:
        UserError: it is a class, or lacks something.
    """
    if isinstance(prior, type):
        raise UserError(f"{what}: expected a prior, found the class {prior.__name__} itself")
    lacking = [part for part in _PARTS if not hasattr(prior, part)]
    if lacking:
        raise UserError(f"{what}: expected a prior, found one without {', '.join(lacking)}")
