"""A tiny autoencoder (TAESD) in place of the full encoder: faster, with an approximate gradient.

Its latents are already scaled, as those of ``vae`` are after scaling, so they are interchangeable.
What is traded: the gradient of the renders is that of a small distilled network. It points the
same way in the large and differs in detail, so the paper's method is exact only without it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from gscomplete.errors import UserError
from gscomplete.priors.latent.folders import find_tensor_file
from gscomplete.priors.latent.networks import load_strictly, require
from gscomplete.priors.latent.tensor_files import TensorFile, check_tensors
from gscomplete.util.jsonio import read_json


def load_tiny_vae(folder: Path) -> Any:
    """Load an ``AutoencoderTiny`` from a diffusers folder, strictly, on the CPU.

    Raises:
        UserError: a file is missing, damaged, or of another kind of network.
    """
    data = read_json(folder / "config.json")
    found = data.get("_class_name") if isinstance(data, dict) else None
    if found != "AutoencoderTiny":
        raise UserError(
            f"{folder / 'config.json'}: _class_name: expected AutoencoderTiny, found {found}"
        )
    with torch.device("meta"):
        vae = require("diffusers").AutoencoderTiny.from_config(data)
    file = TensorFile(find_tensor_file(folder))
    expected = {name: tuple(value.shape) for name, value in vae.state_dict().items()}
    check_tensors(file.path, file.shapes, expected, what="the AutoencoderTiny of config.json")
    return load_strictly(vae, file.get_all(expected))
