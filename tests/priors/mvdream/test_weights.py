"""The three layouts give the same networks, and files that are not exactly MVDream are refused."""

import json
import shutil
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

pytest.importorskip("diffusers", reason="the extra gscomplete[mvdream] is not installed")
pytest.importorskip("transformers", reason="the extra gscomplete[mvdream] is not installed")

from gscomplete.errors import UserError
from gscomplete.priors.latent.tensor_files import TensorFile
from gscomplete.priors.mvdream import keys
from gscomplete.priors.mvdream.convert import convert, verify_digests
from gscomplete.priors.mvdream.weights import (
    MANIFEST_FILE,
    Weights,
    is_mvdream_folder,
    open_weights,
)
from tests.builders.tiny_mvdream import TINY, original_tensors, write_folder, write_original


@pytest.fixture(scope="module")
def original(tmp_path_factory) -> Path:
    return write_original(tmp_path_factory.mktemp("a"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return write_folder(tmp_path_factory.mktemp("b") / "mvdream")


@torch.no_grad()
def outputs(weights: Weights) -> list[torch.Tensor]:
    """What each of the three networks computes."""
    g = torch.Generator().manual_seed(0)
    latents = torch.randn(4, 4, 4, 4, generator=g)
    context = torch.randn(4, 77, weights.config.unet.context_dim, generator=g)
    cameras, images = torch.randn(4, 16, generator=g), torch.rand(1, 3, 16, 16, generator=g)
    ids = torch.randint(0, 49408, (1, 77), generator=g)
    noise = weights.unet().float()(latents, torch.full((4,), 500), context, cameras)
    moments = weights.vae().float().encode(images).latent_dist.mean
    return [noise, moments, weights.text_tower().float()(input_ids=ids).last_hidden_state]


def assert_same(one: Weights, other: Weights) -> None:
    assert one.config == other.config
    for a, b in zip(outputs(one), outputs(other), strict=True):
        assert torch.equal(a, b)


def test_all_layouts_give_the_same_outputs(original, folder, tmp_path):
    a, b = open_weights(original), open_weights(folder)
    c = convert(original, tmp_path / "c")
    d = convert(folder, tmp_path / "d", storage="float16")
    assert [w.layout for w in (a, b, c, d)] == ["original", "folder", "converted", "converted"]
    for other in (b, c, d, convert(c.path, tmp_path / "e")):
        assert_same(a, other)
    for path in (folder, c.path):
        assert is_mvdream_folder(path)
    verify_digests(c.path)
    assert sum(f.stat().st_size for f in d.files) < 0.55 * sum(f.stat().st_size for f in c.files)
    assert a.fingerprint() != c.fingerprint() != d.fingerprint()


def test_original_tensors_as_safetensors_are_accepted(original, tmp_path):
    save_file(original_tensors(), tmp_path / "tiny.safetensors")
    shutil.copy(original.with_suffix(".json"), tmp_path / "tiny.json")
    assert_same(open_weights(original), open_weights(tmp_path / "tiny.safetensors"))


def test_diffusers_own_loader_would_not_notice(folder):
    """Why ``from_pretrained`` is not used: on layout (b) it returns random numbers."""
    from diffusers import UNet2DConditionModel
    from diffusers.utils import logging

    level = logging.get_verbosity()
    logging.set_verbosity(logging.CRITICAL)
    try:
        sizes = {"block_out_channels": (32,), "down_block_types": ("DownBlock2D",)}
        sizes |= {"up_block_types": ("UpBlock2D",), "mid_block_type": None}
        unet = UNet2DConditionModel.from_pretrained(folder / "unet", **sizes)
    finally:
        logging.set_verbosity(level)
    stored = load_file(folder / "unet/diffusion_pytorch_model.safetensors")
    assert not set(unet.state_dict()) & set(stored)


def rewritten(original: Path, tmp_path: Path, change) -> Path:
    """Layout (a) with a change to its tensors."""
    tensors = torch.load(original, weights_only=True)
    change(tensors)
    path = tmp_path / original.name
    torch.save(tensors, path)
    shutil.copy(original.with_suffix(".json"), path.with_suffix(".json"))
    return path


UNET_KEY = "model.diffusion_model.input_blocks.0.0.weight"
TEXT_KEY = "cond_stage_model.model.transformer.resblocks.0.attn.in_proj_weight"
VAE_KEY = "first_stage_model.quant_conv.bias"


@pytest.mark.parametrize("key", [UNET_KEY, TEXT_KEY, VAE_KEY])
def test_a_renamed_tensor_is_named(original, tmp_path, key):
    path = rewritten(original, tmp_path, lambda t: t.update({key + "x": t.pop(key)}))
    with pytest.raises(UserError, match=f"missing 1: {key}; unexpected 1: {key}x"):
        open_weights(path)


@pytest.mark.parametrize("key", [UNET_KEY, TEXT_KEY, VAE_KEY])
def test_another_shape_is_named(original, tmp_path, key):
    path = rewritten(original, tmp_path, lambda t: t.update({key: t[key][:-1].clone()}))
    with pytest.raises(UserError, match=rf"other shape 1: {key} \(expected \S+, found \S+\)"):
        open_weights(path)


@pytest.mark.parametrize("keep", [0.0, 0.01, 0.5, 0.999])
def test_a_truncated_file_is_refused(original, tmp_path, keep):
    for name in (original.name, "tiny.safetensors"):
        path = tmp_path / name
        if name == original.name:
            data = original.read_bytes()
        else:
            save_file({"a": torch.zeros(10000)}, path)
            data = path.read_bytes()
        path.write_bytes(data[: int(keep * len(data))])
        with pytest.raises(UserError, match="found damage"):
            open_weights(path)


@pytest.mark.parametrize("suffix", [".pt", ".safetensors"])
@pytest.mark.parametrize("dtype", [torch.float16, torch.float32])
def test_weights_that_are_not_finite_are_named(tmp_path, suffix, dtype):
    path = tmp_path / f"w{suffix}"
    tensors = {"large": torch.full((99,), 6e4, dtype=dtype), "odd": torch.zeros(9, dtype=dtype)}
    for value in (0.0, torch.nan, -torch.inf):
        tensors["odd"][3] = value
        (torch.save if suffix == ".pt" else save_file)(tensors, path)
        file = TensorFile(path)
        assert torch.equal(file.get("large"), tensors["large"])
        if value == 0.0:
            assert torch.equal(file.get_all(("odd",))["odd"], tensors["odd"])
        else:
            with pytest.raises(UserError, match="odd: expected finite values, found 1 "):
                file.get("odd")


def test_other_contents_are_named(original, tmp_path):
    path = rewritten(original, tmp_path, lambda t: t.update(epoch=3))
    with pytest.raises(UserError, match="epoch: expected a tensor, found int"):
        open_weights(path)
    wrapped = tmp_path / "wrapped.pt"
    torch.save({"state_dict": original_tensors()}, wrapped)
    with pytest.raises(UserError, match="state_dict: expected a tensor, found dict"):
        open_weights(wrapped)
    evil = tmp_path / "evil.pt"
    torch.save({"a": Path("/")}, evil)
    with pytest.raises(UserError, match="expected PyTorch's file of named tensors"):
        open_weights(evil)
    (tmp_path / "empty").mkdir()
    with pytest.raises(UserError, match="expected MVDream's weights"):
        open_weights(tmp_path / "empty")


def test_another_noise_schedule_is_refused(original, tmp_path):
    linear = torch.cumprod(1 - torch.linspace(0.00085, 0.012, 1000), 0)
    path = rewritten(original, tmp_path, lambda t: t.update(alphas_cumprod=linear))
    with pytest.raises(UserError, match="alphas_cumprod: expected the schedule linear in sqrt"):
        open_weights(path)


def test_a_schedule_is_all_there_or_not_at_all(original, tmp_path):
    path = rewritten(original, tmp_path, lambda t: [t.pop(k) for k in keys.SCHEDULE_VECTORS])
    assert open_weights(path).config == TINY
    path = rewritten(original, tmp_path, lambda t: t.pop("betas"))
    with pytest.raises(UserError, match="missing 1: betas"):
        open_weights(path)


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("unet/config.json", {"_class_name": "UNet2DConditionModel"}, "_class_name"),
        ("unet/config.json", {"ip_dim": 16}, "ip_dim"),
        ("unet/config.json", {"model_channels": 64}, "other shape"),
        ("unet/config.json", {"num_head_channels": 0}, "num_head_channels: expected positive"),
        ("unet/config.json", {"channel_mult": []}, "channel_mult: expected positive"),
        ("vae/config.json", {"layers_per_block": 2}, "missing"),
        ("vae/config.json", {"_class_name": "VQModel"}, "_class_name"),
        ("text_encoder/config.json", {"num_hidden_layers": 3}, "missing"),
        ("text_encoder/config.json", {"architectures": ["T5"]}, "architectures"),
        ("text_encoder/config.json", {"architectures": 5}, "architectures"),
        ("text_encoder/config.json", {"hidden_size": None}, "hidden_size: expected 1 to"),
        ("vae/config.json", {"block_out_channels": 64}, "block_out_channels"),
        ("vae/config.json", {"block_out_channels": [0, 8]}, "block_out_channels"),
        ("vae/config.json", {"norm_num_groups": 10**30}, "norm_num_groups"),
        ("vae/config.json", {"scaling_factor": "x"}, "scaling_factor"),
    ],
)
def test_a_folder_that_does_not_fit_is_refused(folder, tmp_path, file, change, message):
    path = tmp_path / "b"
    shutil.copytree(folder, path)
    data = json.loads((path / file).read_text()) | change
    (path / file).write_text(json.dumps(data))
    with pytest.raises(UserError, match=message):
        open_weights(path)


def test_missing_files_of_a_folder_are_named(folder, tmp_path):
    for name in ("unet", "vae", "text_encoder"):
        path = tmp_path / name
        shutil.copytree(folder, path)
        for file in (path / name).glob("*.safetensors"):
            file.unlink()
        with pytest.raises(UserError, match=f"{name}: expected a file of weights"):
            open_weights(path)


def test_a_damaged_converted_folder_is_refused(original, tmp_path):
    out = convert(original, tmp_path / "c").path
    path = out / "vae.safetensors"
    data = bytearray(path.read_bytes())
    data[-3] ^= 0xFF
    path.write_bytes(bytes(data))
    with pytest.raises(UserError, match="sha256"):
        verify_digests(out)
    path.write_bytes(bytes(data[:-8]))
    with pytest.raises(UserError, match="damage"):
        open_weights(out)
    path.unlink()
    with pytest.raises(UserError, match="found nothing"):
        open_weights(out)
    manifest = json.loads((out / MANIFEST_FILE).read_text())
    (out / MANIFEST_FILE).write_text(json.dumps(manifest | {"version": 9}))
    with pytest.raises(UserError, match="version: expected 1, found 9"):
        open_weights(out)


def test_nothing_is_left_of_a_conversion_that_fails(original, tmp_path):
    bad = rewritten(original, tmp_path, lambda t: t.pop(VAE_KEY))
    with pytest.raises(UserError):
        convert(bad, tmp_path / "out")
    existing = tmp_path / "existing"
    existing.mkdir()
    with pytest.raises(UserError, match="does not exist yet"):
        convert(original, existing)
    with pytest.raises(UserError, match="cannot create"):
        convert(original, Path("/proc/forbidden/out"))
    assert {p.name for p in tmp_path.iterdir()} == {
        bad.name,
        bad.with_suffix(".json").name,
        "existing",
    }
