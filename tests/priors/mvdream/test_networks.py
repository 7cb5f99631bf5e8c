"""Autoencoder and text tower against independent float64 ones; names and shapes at full size."""

from pathlib import Path

import pytest
import torch

pytest.importorskip("diffusers", reason="the extra gscomplete[mvdream] is not installed")
pytest.importorskip("transformers", reason="the extra gscomplete[mvdream] is not installed")

from gscomplete.errors import UserError
from gscomplete.priors.latent.networks import TextConfig, build_text_tower, build_vae, load_strictly
from gscomplete.priors.mvdream import keys
from gscomplete.priors.mvdream.attention import check_joint_attention
from gscomplete.priors.mvdream.config import PUBLISHED, MVDreamConfig, UNetConfig
from gscomplete.priors.mvdream.model import build_unet
from gscomplete.priors.mvdream.store import MVDREAM
from gscomplete.priors.mvdream.weights import COMPONENTS, component_sources, expected_original
from tests.builders.tiny_mvdream import TINY, component, original_tensors
from tests.priors.mvdream import reference

SHARED = Path(__file__).resolve().parents[4] / "shared/mvdream"
LISTS = {
    "unet": ("mvdream_keys_original.tsv", 690),
    "vae": ("mvdream_keys_vae_original.tsv", 248),
    "text": ("mvdream_keys_text_original.tsv", 294),
}

needs_lists = pytest.mark.skipif(
    not (SHARED / LISTS["unet"][0]).exists(), reason="../shared/mvdream is not here"
)


def rows(name: str) -> list[list[str]]:
    return [line.split("\t") for line in (SHARED / name).read_text().splitlines()]


def shape_of(text: str) -> tuple[int, ...]:
    return () if text == "scalar" else tuple(map(int, text.split("x")))


@needs_lists
@pytest.mark.parametrize("name", COMPONENTS)
def test_names_and_shapes_at_full_size(name):
    file, count = LISTS[name]
    listed = {row[0]: shape_of(row[1]) for row in rows(file)}
    expected = expected_original(PUBLISHED, name)
    assert {keys.PREFIXES[name] + k: v for k, v in expected.items()} == listed
    assert len(listed) == count


@needs_lists
def test_our_names_are_the_listed_diffusers_names():
    sources = component_sources(PUBLISHED, "unet")
    found = {n: (keys.PREFIXES["unet"] + s.name, shape) for n, (s, shape) in sources.items()}
    table = rows("mvdream_keys_unet2dcondition.tsv")
    assert found == {row[0]: (row[2], shape_of(row[1])) for row in table}
    vae = component_sources(PUBLISHED, "vae")
    assert {n: keys.PREFIXES["vae"] + s.name for n, (s, _) in vae.items()} == {
        row[2]: row[0] for row in rows("mvdream_keys_vae_original.tsv")
    }


def test_published_sizes():
    with torch.device("meta"):
        unet, vae = build_unet(PUBLISHED.unet), build_vae(PUBLISHED.vae)
    assert sum(value.numel() for value in unet.parameters()) == 867_572_164
    assert sum(value.numel() for value in vae.parameters()) == 83_653_863
    assert check_joint_attention(unet, 4) == 16
    values = sum(
        torch.Size(shape).numel()
        for n in COMPONENTS
        for shape in expected_original(PUBLISHED, n).values()
    )
    assert MVDREAM.bytes == 4 * values


def loaded(name: str, build):
    original = component(original_tensors(), name)
    with torch.device("meta"):
        module = build()
    sources = component_sources(TINY, name)
    state = {ours: source.take(original[source.name]) for ours, (source, _) in sources.items()}
    return load_strictly(module, state), original


@torch.no_grad()
def test_autoencoder_equals_an_independent_float64_one():
    vae, original = loaded("vae", lambda: build_vae(TINY.vae))
    g = torch.Generator().manual_seed(0)
    images = torch.rand(2, 3, 32, 24, generator=g, dtype=torch.float64) * 2 - 1
    mean, deviation = reference.vae_moments(original, images, groups=TINY.vae.norm_groups)
    posterior = vae.encode(images).latent_dist
    assert (posterior.mean - mean).abs().max() < 1e-11
    assert (posterior.std - deviation).abs().max() < 1e-11
    decoded = reference.vae_decode(original, mean, groups=TINY.vae.norm_groups)
    assert (vae.decode(mean).sample - decoded).abs().max() < 1e-11
    assert decoded.std() > 0.1


@torch.no_grad()
def test_text_tower_equals_an_independent_float64_one():
    """Its penultimate block and final norm; the last block is there and must not matter."""
    tower, original = loaded("text", lambda: build_text_tower(TINY.text))
    ids = torch.tensor([[49406, 320, 736, 11230, 49407] + [0] * 72])
    found = tower(input_ids=ids).last_hidden_state
    expected = reference.text_tower(original, ids, heads=TINY.text.heads)
    assert (found - expected).abs().max() < 1e-11
    unused = f"transformer.resblocks.{TINY.text.layers}.mlp.c_fc.weight"
    assert unused in original
    original[unused] = original[unused] * 100
    again = reference.text_tower(original, ids, heads=TINY.text.heads)
    assert torch.equal(again, expected)


def test_configurations_of_other_models_are_refused():
    for data, field in (
        ({"ip_dim": 16}, "ip_dim"),
        ({"num_heads": 8}, "num_heads"),
        ({"legacy": True}, "legacy"),
        ({"use_linear_in_transformer": False}, "use_linear_in_transformer"),
        ({"nonsense": 1}, "nonsense"),
        ({"model_channels": 48}, "divisible by 32"),
        ({"model_channels": "wide"}, "model_channels"),
    ):
        with pytest.raises(UserError, match=field):
            UNetConfig.from_original(data, "config.json")
    assert UNetConfig.from_original({"_class_name": "x", "image_size": 32}, "c") == UNetConfig()
    with pytest.raises(ValueError, match="context_dim"):
        MVDreamConfig(text=TextConfig(width=768))
