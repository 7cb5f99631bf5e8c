"""Weights and configurations of priors: the embedded one's, MVDream's tensors, diffusers' files."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path


def prior_seeds(folder: Path) -> list[tuple[str, Callable[[Path], object]]]:
    """Write the files; return each with its reader."""
    import torch
    from safetensors.torch import save_file

    from gscomplete.priors.diffusers_2d import read_schedule
    from gscomplete.priors.latent.folders import read_text_config, read_vae_config
    from gscomplete.priors.latent.tensor_files import TensorFile
    from gscomplete.priors.mvdream.config import UNetConfig
    from gscomplete.util.jsonio import read_json

    tensors = {"a.weight": torch.ones(3, 4), "b": torch.ones(2)}
    save_file(tensors, folder / "w.safetensors")
    torch.save(tensors, folder / "w.pt")
    vae = {"_class_name": "AutoencoderKL", "block_out_channels": [8, 16], "latent_channels": 4}
    vae |= {"layers_per_block": 1, "norm_num_groups": 4, "scaling_factor": 0.18}
    (folder / "vae.json").write_text(json.dumps(vae))
    text = {"architectures": ["CLIPTextModel"], "hidden_size": 32, "num_attention_heads": 4}
    text |= {"num_hidden_layers": 2, "intermediate_size": 64, "hidden_act": "gelu"}
    (folder / "text.json").write_text(json.dumps(text))
    schedule = {"num_train_timesteps": 1000, "beta_start": 1e-4, "beta_end": 0.02}
    schedule |= {"beta_schedule": "linear", "prediction_type": "epsilon"}
    (folder / "scheduler_config.json").write_text(json.dumps(schedule))

    (folder / "unet.json").write_text(json.dumps({"model_channels": 64, "channel_mult": [1, 2]}))

    def read_tensors(path: Path) -> object:
        files = TensorFile(path)
        return [files.get(name) for name in tensors]

    return [
        ("w.safetensors", read_tensors),
        ("w.pt", read_tensors),
        ("unet.json", lambda path: UNetConfig.from_original(read_json(path), str(path))),
        ("vae.json", read_vae_config),
        ("text.json", read_text_config),
        ("scheduler_config.json", read_schedule),
        *_embedded(folder),
    ]


def _embedded(folder: Path) -> list[tuple[str, Callable[[Path], object]]]:
    """Write the weights of a tiny embedded prior."""
    from gscomplete.priors.base import PriorViews
    from gscomplete.priors.embedded.model import FourViewDenoiser, ModelConfig
    from gscomplete.priors.embedded.weights import (
        CONFIG_FILE,
        FORMAT_VERSION,
        WEIGHTS_FILE,
        PriorConfig,
        TrainingRecord,
        load_weights,
        save_weights,
    )

    size = ModelConfig(
        resolution_px=16,
        widths=(16, 16, 32),
        blocks=(1, 1, 1),
        transformers=(1, 1),
        head_width=16,
        groups=4,
        embedding=32,
        text_width=16,
        text_length=6,
        vocabulary_size=6,
    )
    views = PriorViews(40.0, (1.35, 1.9), (-10.0, 45.0), size.resolution_px)
    record = TrainingRecord(steps=1, sets=1, hours=0.0, machine="", seed=0)
    words = ("a", "b", "c", "d")
    home = folder / "weights"
    home.mkdir()
    config = PriorConfig(FORMAT_VERSION, size, views, words, "int8", record)
    save_weights(home, FourViewDenoiser(size).state_dict(), config)
    return [
        (f"weights/{name}", lambda path: load_weights(path.parent)[2])
        for name in (CONFIG_FILE, WEIGHTS_FILE)
    ]
