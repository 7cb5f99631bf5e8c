"""A diffusers text-to-image folder as a prior: views independent, folders read strictly."""

import json
import shutil
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

pytest.importorskip("diffusers", reason="the extra gscomplete[mvdream] is not installed")
pytest.importorskip("transformers", reason="the extra gscomplete[mvdream] is not installed")

import diffusers

from gscomplete.errors import UserError
from gscomplete.priors import load_prior
from gscomplete.priors.base import FourViews, Guidance
from gscomplete.priors.diffusers_2d import load_diffusers_2d, read_schedule
from gscomplete.priors.latent.guidance import NoiseSchedule
from gscomplete.priors.latent.text import CACHE_VARIABLE
from gscomplete.views import four_view_orbit
from tests.priors.mvdream.tiny import (
    TINY,
    original_tensors,
    random_tensors,
    write_text_folder,
    write_vae_folder,
)

UNET = {
    "_class_name": "UNet2DConditionModel",
    "sample_size": 4,
    "block_out_channels": [32, 32],
    "down_block_types": ["CrossAttnDownBlock2D", "DownBlock2D"],
    "up_block_types": ["UpBlock2D", "CrossAttnUpBlock2D"],
    "layers_per_block": 1,
    "attention_head_dim": 2,
    "cross_attention_dim": TINY.text.width,
}
SCHEDULER = {
    "_class_name": "PNDMScheduler",
    "num_train_timesteps": 1000,
    "beta_start": 0.00085,
    "beta_end": 0.012,
    "beta_schedule": "scaled_linear",
}
WEIGHTS = "unet/diffusion_pytorch_model.safetensors"


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("2d") / "tiny-sd"
    for name in ("unet", "vae", "text_encoder", "tokenizer", "scheduler"):
        (path / name).mkdir(parents=True)
    tensors = original_tensors()
    write_vae_folder(path / "vae", TINY, tensors)
    write_text_folder(path / "text_encoder", TINY, tensors)
    with torch.device("meta"):
        unet = diffusers.UNet2DConditionModel.from_config(UNET)
    shapes = {name: tuple(value.shape) for name, value in unet.state_dict().items()}
    save_file(random_tensors(shapes, 3), path / WEIGHTS)
    for name, data in (
        ("unet/config.json", UNET),
        ("scheduler/scheduler_config.json", SCHEDULER),
        ("tokenizer/tokenizer_config.json", {"pad_token": "<|endoftext|>"}),
        ("model_index.json", {"_class_name": "StableDiffusionPipeline"}),
    ):
        (path / name).write_text(json.dumps(data))
    return path


def changed(folder: Path, tmp_path: Path, file: str, change: dict) -> Path:
    path = tmp_path / "changed"
    shutil.copytree(folder, path)
    data = json.loads((path / file).read_text()) | change
    (path / file).write_text(json.dumps(data))
    return path


def renders() -> FourViews:
    g = torch.Generator().manual_seed(0)
    cameras = four_view_orbit(0, 10, radius=2, fov_deg=40, size_px=32)
    color = torch.rand(4, 32, 32, 3, generator=g).requires_grad_()
    return FourViews(color, torch.ones(4, 32, 32), torch.ones(4, 32, 32), cameras)


def test_distills_with_a_gradient_for_every_view(folder):
    prior, views = load_prior(str(folder)), renders()
    assert prior.name == "diffusers:tiny-sd"
    assert prior.views.resolution_px == 32
    loss = prior.distill(views, 500, prior.condition("a mug"), torch.Generator().manual_seed(0))
    gradient = torch.autograd.grad(loss, views.color)[0]
    assert torch.isfinite(gradient).all()
    assert float(gradient.abs().amax(dim=(1, 2, 3)).min()) > 0


def test_views_are_denoised_independently(folder):
    """Changing one view leaves the others' noise as it was; rescaling is by image too."""
    denoiser = load_diffusers_2d(folder)._denoiser
    assert denoiser.group == 1
    g = torch.Generator().manual_seed(0)
    noisy, context = torch.randn(4, 4, 4, 4, generator=g), torch.randn(1, 77, 24, generator=g)
    cameras = renders().cameras
    one = denoiser(noisy, 500, context, cameras)
    noisy[2] += 1
    other = denoiser(noisy, 500, context, cameras)
    same = [torch.equal(a, b) for a, b in zip(one, other, strict=True)]
    assert same == [True, True, False, True]


def test_velocity_models_are_converted(folder, tmp_path):
    path = changed(
        folder, tmp_path, "scheduler/scheduler_config.json", {"prediction_type": "v_prediction"}
    )
    velocity, plain = load_diffusers_2d(path)._denoiser, load_diffusers_2d(folder)._denoiser
    noisy, context = torch.randn(4, 4, 4, 4), torch.randn(1, 77, 24)
    cameras = renders().cameras
    a, s = NoiseSchedule.stable_diffusion().scales(300)
    expected = a * plain(noisy, 300, context, cameras) + s * noisy
    found = velocity(noisy, 300, context, cameras)
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-4)


def test_padding_follows_the_folder(folder, tmp_path):
    path = changed(folder, tmp_path, "tokenizer/tokenizer_config.json", {"pad_token": "!"})
    one, other = load_diffusers_2d(folder), load_diffusers_2d(path)
    assert not torch.equal(one.condition("a").context, other.condition("a").context)
    (path / "tokenizer/tokenizer_config.json").write_text('{"pad_token": "?"}')
    with pytest.raises(UserError, match="pad_token"):
        load_diffusers_2d(path)


def test_the_special_tokens_have_the_last_word_on_padding(folder, tmp_path):
    """As in the original Stable Diffusion 2.1, whose two files differ."""
    path = changed(folder, tmp_path, "tokenizer/tokenizer_config.json", {"pad_token": "!"})
    padded = load_diffusers_2d(path).condition("a").context
    config, special = (
        path / "tokenizer" / f"{name}.json" for name in ("tokenizer_config", "special_tokens_map")
    )
    config.write_text('{"pad_token": "<|endoftext|>"}')
    special.write_text('{"pad_token": {"content": "!"}}')
    assert torch.equal(load_diffusers_2d(path).condition("a").context, padded)


def test_a_schedule_without_signal_at_its_end_is_refused(folder, tmp_path):
    name = "scheduler/scheduler_config.json"
    path = changed(folder, tmp_path, name, {"rescale_betas_zero_snr": True})
    with pytest.raises(UserError, match="expected some signal"):
        load_diffusers_2d(path)


def test_default_guidance(folder):
    assert load_diffusers_2d(folder)._guidance == Guidance(100.0, rescale=0.5)


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("unet/config.json", {"_class_name": "FluxTransformer2DModel"}, "_class_name"),
        ("unet/config.json", {"addition_embed_type": "text_time"}, "addition_embed_type"),
        ("unet/config.json", {"in_channels": 9}, "in_channels"),
        ("unet/config.json", {"cross_attention_dim": 32}, "other shape"),
        ("unet/config.json", {"layers_per_block": 2}, "missing"),
        ("text_encoder/config.json", {"architectures": ["T5EncoderModel"]}, "architectures"),
        ("scheduler/scheduler_config.json", {"prediction_type": "flow"}, "prediction_type"),
        ("scheduler/scheduler_config.json", {"beta_schedule": "odd"}, "beta_schedule"),
        ("scheduler/scheduler_config.json", {"num_train_timesteps": 10**9}, "num_train_timesteps"),
        ("scheduler/scheduler_config.json", {"trained_betas": []}, "shares of noise"),
        ("scheduler/scheduler_config.json", {"beta_start": -0.5}, "beta"),
    ],
)
def test_other_models_are_refused(folder, tmp_path, file, change, message):
    with pytest.raises(UserError, match=message):
        load_diffusers_2d(changed(folder, tmp_path, file, change))


def test_a_missing_tensor_is_not_filled_in(folder, tmp_path):
    path = changed(folder, tmp_path, "unet/config.json", {})
    tensors = load_file(path / WEIGHTS)
    tensors["conv_in.weights"] = tensors.pop("conv_in.weight")
    save_file(tensors, path / WEIGHTS)
    with pytest.raises(UserError, match=r"missing 1: conv_in\.weight; unexpected 1: conv_in\.w"):
        load_diffusers_2d(path)


@pytest.mark.parametrize("name", ["unet", "vae", "text_encoder", "scheduler"])
def test_missing_parts_are_named(folder, tmp_path, name):
    path = changed(folder, tmp_path, "unet/config.json", {})
    shutil.rmtree(path / name)
    with pytest.raises(UserError, match=name):
        load_prior(str(path))


def test_schedules_without_signal_are_refused(folder, tmp_path):
    path = tmp_path / "scheduler_config.json"
    path.write_text(json.dumps(SCHEDULER | {"trained_betas": [0.5, 1.0]}))
    with pytest.raises(UserError, match="signal"):
        read_schedule(path)
    path.write_text("[]")
    with pytest.raises(UserError, match="object"):
        read_schedule(path)


@pytest.mark.parametrize(
    ("file", "change"),
    [
        ("scheduler/scheduler_config.json", {"prediction_type": "v_prediction"}),
        ("scheduler/scheduler_config.json", {"beta_end": 0.013}),
        ("vae/config.json", {"scaling_factor": 0.2}),
        ("tokenizer/tokenizer_config.json", {"pad_token": "!"}),
    ],
)
def test_a_folder_that_would_give_another_result_is_another_prior(folder, tmp_path, file, change):
    other = load_diffusers_2d(changed(folder, tmp_path, file, change))
    assert other.identity != load_diffusers_2d(folder).identity
