"""The two learned metrics of the paper: E_LPIPS and S_CLIP.

Conventions
-----------
* Both need an optional package and weights that are already on the machine; nothing is downloaded
  here. Without them the answer is ``Unavailable`` with the reason, never another number.
* E_LPIPS (Zhang et al. 2018, AlexNet) compares renders of O and P from c over mid-grey; its
  per-pixel map is averaged with the weights M_c.
* S_CLIP is 100 times the mean cosine between the CLIP embedding of P's render from c and those of
  O's renders from azimuth offsets 0, 90, 180 and 270 degrees, over white.
"""

from __future__ import annotations

import importlib
import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from gscomplete.evaluate.metrics import MID_GREY
from gscomplete.render import render
from gscomplete.splats import Splats
from gscomplete.views import Cameras

CLIP_MODEL = "openai/clip-vit-large-patch14"
"""Name, or folder, of the CLIP model. The paper does not say which it used."""
ALEXNET_FILE = "alexnet-owt-7be5be79.pth"
"""Backbone weights as torchvision caches them."""


@dataclass(frozen=True, slots=True)
class Unavailable:
    """Why a metric could not be computed."""

    reason: str


def found_here(model: str = CLIP_MODEL) -> tuple[str, ...]:
    """Name the packages and weights for these metrics that seem to be here, without loading any."""
    needs = {
        "lpips": _is_installed("lpips"),
        ALEXNET_FILE: _alexnet_file().is_file(),
        "transformers": _is_installed("transformers"),
        model: _may_be_here(model),
    }
    return tuple(name for name, is_here in needs.items() if is_here)


def lpips_error(completed: Splats, partial: Splats, camera: Cameras) -> float | Unavailable:
    """Measure E_LPIPS from the input view; lower is better."""
    package = _optional("lpips")
    if isinstance(package, Unavailable):
        return package
    if not _alexnet_file().is_file():
        return Unavailable(f"no AlexNet weights ({ALEXNET_FILE} is not in torch's cache)")
    network = package.LPIPS(net="alex", spatial=True, verbose=False)
    with torch.no_grad():
        grey = partial.means.new_tensor(MID_GREY)
        ours, theirs = (render(splats, camera, grey) for splats in (completed, partial))
        images = [2.0 * view.color.permute(0, 3, 1, 2).cpu() - 1.0 for view in (ours, theirs)]
        error = network(*images)[:, 0]  # [V, H, W]
    mask = theirs.alpha.cpu()
    return float((mask * error).sum() / mask.sum().clamp_min(1e-6))


def clip_similarity(
    completed: Splats,
    partial: Splats,
    camera: Cameras,
    four_sides: Cameras,
    model: str = CLIP_MODEL,
) -> float | Unavailable:
    """Measure S_CLIP; higher is better."""
    missing = Unavailable(f"no CLIP weights ({model} is not on this machine)")
    if not _may_be_here(model):
        return missing  # the package alone takes a second to load
    package = _optional("transformers")
    if isinstance(package, Unavailable):
        return package
    try:
        network = package.CLIPModel.from_pretrained(model, local_files_only=True)
        processor = package.CLIPImageProcessor.from_pretrained(model, local_files_only=True)
    except (OSError, ValueError):
        return missing
    with torch.no_grad():
        white = partial.means.new_ones(3)
        views = torch.cat(
            [render(partial, camera, white).color, render(completed, four_sides, white).color]
        )
        pixels = [(255.0 * view.clamp(0, 1)).to(torch.uint8).cpu().numpy() for view in views]
        inputs = processor(images=pixels, return_tensors="pt")
        found = network.get_image_features(**inputs)
    embedding = getattr(found, "pooler_output", found)  # a tensor before transformers 5
    unit = torch.nn.functional.normalize(embedding, dim=-1)
    return 100.0 * float((unit[1:] @ unit[0]).mean())


def _alexnet_file() -> Path:
    return Path(torch.hub.get_dir()) / "checkpoints" / ALEXNET_FILE


def _is_installed(package: str) -> bool:
    return importlib.util.find_spec(package) is not None


def _may_be_here(model: str) -> bool:
    """Tell whether a model is a folder, or lies in the hub's cache as far as names say."""
    if Path(model).is_dir():
        return True
    hub = _optional("huggingface_hub.constants")
    if isinstance(hub, Unavailable):
        return True
    return (Path(hub.HF_HUB_CACHE) / f"models--{model.replace('/', '--')}").is_dir()


def _optional(name: str) -> Any:
    """Import an optional package, or say why not."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return Unavailable(f"package {name} is not installed (pip install gscomplete[metrics])")
