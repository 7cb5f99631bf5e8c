"""Any diffusers text-to-image folder as a prior, for those without MVDream.

Conventions
-----------
* The four views of a ring are denoised independently: they know nothing of each other or of their
  cameras, so objects with several fronts are to be expected (the "Janus problem").
* Folders of Stable Diffusion 1.x and 2.x and their fine-tunings work; SDXL and later do not.
* The folder is read from disk only, and strictly: a network whose file lacks a tensor is refused,
  not filled with random numbers.
* Prompts are cut by CLIP's vocabulary and padded as the folder's tokenizer says; text, schedule
  and prediction type come from the folder's configuration files.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.priors.base import PriorViews
from gscomplete.priors.latent.folders import (
    find_tensor_file,
    read_text_config,
    read_vae_config,
    text_part,
    vae_part,
)
from gscomplete.priors.latent.guidance import NoiseSchedule
from gscomplete.priors.latent.networks import (
    VAEConfig,
    build_text_tower,
    build_vae,
    load_strictly,
    require,
)
from gscomplete.priors.latent.on_device import deciding_settings, prepare, prepare_codec
from gscomplete.priors.latent.prior import (
    VIEWS,
    LatentModel,
    LatentPrior,
    PriorIdentity,
    default_guidance,
)
from gscomplete.priors.latent.settings import LatentPriorSettings, memory_plan, unet_dtype
from gscomplete.priors.latent.tensor_files import TensorFile, check_tensors, fingerprint
from gscomplete.priors.latent.text import PromptEncoder, cache_home
from gscomplete.priors.latent.tokenizer import END_ID, OPEN_CLIP_PAD_ID, Tokenizer
from gscomplete.util.jsonio import read_json
from gscomplete.views import Cameras

GUIDANCE_SCALE = 100.0
"""DreamFusion's, for models that know one view at a time."""
_TIMESTEPS = 1000
_PAD_IDS = {"!": OPEN_CLIP_PAD_ID, "<|endoftext|>": END_ID}


class SingleViewDenoiser:
    """A text-to-image UNet that denoises every view by itself."""

    group = 1

    def __init__(
        self,
        unet: Any,
        schedule: NoiseSchedule,
        device: torch.device,
        dtype: torch.dtype,
        settings: LatentPriorSettings,
    ) -> None:
        """Move the network to the device and prepare it as the knobs say."""
        self.schedule = schedule
        self._network = prepare(unet, device, dtype, settings)
        self._device, self._dtype = device, dtype

    @torch.no_grad()
    def __call__(self, noisy: Tensor, timestep: int, context: Tensor, cameras: Cameras) -> Tensor:
        """Predict noise; see :class:`gscomplete.priors.latent.prior.Denoiser`."""
        output = self._network(
            noisy.to(self._dtype),
            torch.full((len(noisy),), timestep, dtype=torch.int64, device=self._device),
            encoder_hidden_states=context.to(self._dtype).repeat_interleave(VIEWS, dim=0),
            return_dict=False,
        )[0]
        return self.schedule.noise_of(output.to(torch.float32, copy=True), noisy, timestep)


def is_diffusers_folder(path: Path) -> bool:
    """Whether a folder looks like a diffusers pipeline."""
    return (path / "model_index.json").is_file() or (path / "unet" / "config.json").is_file()


def load_diffusers_2d(
    folder: Path,
    device: torch.device | str = "cpu",
    settings: LatentPriorSettings | None = None,
) -> LatentPrior:
    """Load a single-view prior from a diffusers folder.

    Raises:
        UserError: a file is missing or damaged, or the folder holds another kind of model.
    """
    device, settings = torch.device(device), settings or LatentPriorSettings()
    plan = memory_plan(settings.memory, device)
    unet, unet_file = _load_unet(folder / "unet")
    with torch.device("meta"):
        vae = build_vae(read_vae_config(folder / "vae" / "config.json"))
        text_config = read_text_config(folder / "text_encoder" / "config.json")
        tower = build_text_tower(text_config)
    vae_tensors = vae_part(folder / "vae", vae)
    text_tensors = text_part(folder / "text_encoder", tower)
    if text_config.width != unet.config.cross_attention_dim:
        raise UserError(
            f"{folder / 'unet' / 'config.json'}: cross_attention_dim: expected the text tower's "
            f"width {text_config.width}, found {unet.config.cross_attention_dim}"
        )
    schedule = read_schedule(folder / "scheduler" / "scheduler_config.json")
    codec = prepare_codec(load_strictly(vae, vae_tensors.state()), device, settings, plan)
    dtype = unet_dtype(settings.precision, device)
    size_px = int(unet.config.sample_size or 64) * codec.downsampling
    guidance = default_guidance(settings, GUIDANCE_SCALE)
    pad_id = _pad_id(folder / "tokenizer")
    folder_settings = {
        "prediction": schedule.prediction,
        "alphas_bar_sha256": hashlib.sha256(repr(schedule.alphas_bar).encode()).hexdigest(),
        "scaling_factor": float(vae.config.scaling_factor),
        "pad_id": pad_id,
    }
    encoder = PromptEncoder(
        Tokenizer(text_config.length, pad_id),
        lambda: load_strictly(tower, text_tensors.state()),
        fingerprint((text_tensors.file.path,)),
        (text_config.length, text_config.width),
        device,
        cache_home() / "prompts",
    )
    model = LatentModel(
        f"diffusers:{folder.resolve().name}",
        SingleViewDenoiser(unet, schedule, device, dtype, settings),
        codec,
        encoder,
        PriorViews(40.0, (1.3, 1.6), (0.0, 30.0), size_px),
        guidance,
    )
    identity = PriorIdentity(
        fingerprint((unet_file, vae_tensors.file.path, text_tensors.file.path)),
        deciding_settings(settings, guidance, "") | folder_settings,
    )
    return LatentPrior(model, settings, plan, device, identity)


def read_schedule(path: Path) -> NoiseSchedule:
    """Read a noise schedule from diffusers' ``scheduler_config.json``.

    Raises:
        UserError: it is missing, or of a kind that distillation cannot use.
    """
    data = read_json(path)
    if not isinstance(data, dict):
        raise UserError(f"{path}: expected an object")
    prediction = data.get("prediction_type", "epsilon")
    if prediction not in ("epsilon", "v_prediction"):
        raise UserError(
            f"{path}: prediction_type: expected epsilon or v_prediction, found {prediction}"
        )
    names = (
        "num_train_timesteps",
        "beta_start",
        "beta_end",
        "beta_schedule",
        "trained_betas",
        "rescale_betas_zero_snr",
    )
    given = {name: data[name] for name in names if data.get(name) is not None}
    steps = given.get("num_train_timesteps", _TIMESTEPS)
    if steps != _TIMESTEPS:
        raise UserError(
            f"{path}: num_train_timesteps: expected {_TIMESTEPS:,}, which the schedules of "
            f"completions are for, found {steps!r}"
        )
    try:
        scheduler = require("diffusers").DDPMScheduler(**given)
        alphas_bar = tuple(scheduler.alphas_cumprod.double().tolist())
    except (NotImplementedError, OverflowError, RuntimeError, TypeError, ValueError) as error:
        raise UserError(f"{path}: beta_schedule: {error}") from error
    if not alphas_bar or not all(0 <= value <= 1 for value in alphas_bar):
        raise UserError(f"{path}: beta_start, beta_end: expected shares of noise, found others")
    if min(alphas_bar) <= 0:
        raise UserError(f"{path}: expected some signal at every timestep, found none at the last")
    return NoiseSchedule(alphas_bar, prediction)


def _load_unet(folder: Path) -> tuple[Any, Path]:
    """Load a text-to-image UNet strictly."""
    path = folder / "config.json"
    data = read_json(path)
    found = data.get("_class_name") if isinstance(data, dict) else None
    if found != "UNet2DConditionModel":
        raise UserError(f"{path}: _class_name: expected UNet2DConditionModel, found {found}")
    for name in ("addition_embed_type", "class_embed_type", "encoder_hid_dim_type"):
        if data.get(name):
            raise UserError(
                f"{path}: {name}: expected a plain text-to-image model (Stable Diffusion 1.x or "
                f"2.x), found {data[name]!r}"
            )
    expected_in = VAEConfig().latent_channels
    if data.get("in_channels", 4) != expected_in:
        raise UserError(
            f"{path}: in_channels: expected {expected_in}, found {data['in_channels']} (an "
            "inpainting or depth model)"
        )
    with torch.device("meta"):
        unet = require("diffusers").UNet2DConditionModel.from_config(data)
    file = TensorFile(find_tensor_file(folder))
    expected = {name: tuple(value.shape) for name, value in unet.state_dict().items()}
    check_tensors(file.path, file.shapes, expected, what="the UNet of config.json")
    return load_strictly(unet, file.get_all(expected)), file.path


def _pad_id(folder: Path) -> int:
    """Return the id that the folder's tokenizer pads with.

    As in transformers, special_tokens_map.json has the last word: the original Stable Diffusion
    2.1 pads with "!" there and with the end token in tokenizer_config.json.

    Raises:
        UserError: it is none of those that CLIP's tokenizers pad with.
    """
    token: Any = "<|endoftext|>"
    path = folder
    for name in ("tokenizer_config.json", "special_tokens_map.json"):
        data = read_json(folder / name) if (folder / name).is_file() else {}
        if isinstance(data, dict) and data.get("pad_token") is not None:
            path, token = folder / name, data["pad_token"]
    token = token.get("content") if isinstance(token, dict) else token
    if token not in _PAD_IDS:
        raise UserError(f"{path}: pad_token: expected one of {list(_PAD_IDS)}, found {token!r}")
    return _PAD_IDS[token]
