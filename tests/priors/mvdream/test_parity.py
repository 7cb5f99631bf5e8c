"""The UNet against the original's recorded outputs and against an independent float64 one.

Each mutation below is a mistake that fails silently: the model runs and its images look like noise
of the right size. In float64 every one of them is far above the bound that the right model meets.
"""

import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

pytest.importorskip("diffusers", reason="the extra gscomplete[mvdream] is not installed")
pytest.importorskip("transformers", reason="the extra gscomplete[mvdream] is not installed")

from diffusers.models.attention_processor import AttnProcessor2_0

from gscomplete.priors.latent.networks import load_strictly
from gscomplete.priors.mvdream import keys
from gscomplete.priors.mvdream.attention import check_joint_attention, install_joint_attention
from gscomplete.priors.mvdream.cameras import camera_matrices
from gscomplete.priors.mvdream.config import UNetConfig
from gscomplete.priors.mvdream.model import MultiViewUNet, build_unet
from gscomplete.views import four_view_orbit
from tests.builders.tiny_mvdream import random_tensors
from tests.priors.mvdream import reference

SHARED = Path(__file__).resolve().parents[4] / "shared/mvdream"
FIXTURES = sorted(path.parent for path in SHARED.glob("*/io.safetensors"))
PREFIX = keys.PREFIXES["unet"]

needs_fixtures = pytest.mark.skipif(not FIXTURES, reason="../shared/mvdream is not here")


class Fixture:
    """A folder of recorded inputs and outputs of the original code."""

    def __init__(self, folder: Path) -> None:
        stated = json.loads((folder / "config.json").read_text())
        self.stated = stated
        self.config = UNetConfig.from_original(
            {**stated["unet"], "num_views": stated["num_frames"]}, str(folder / "config.json")
        )
        self.weights = load_file(folder / "weights.safetensors")
        self.io = load_file(folder / "io.safetensors")

    def model(self, dtype: torch.dtype = torch.float64) -> MultiViewUNet:
        return load_unet(self.config, {k[len(PREFIX) :]: v for k, v in self.weights.items()}, dtype)

    def inputs(self, dtype: torch.dtype = torch.float64) -> dict[str, torch.Tensor]:
        return {
            "latents": self.io["x"].to(dtype),
            "timesteps": self.io["timesteps"],
            "context": self.io["context"].to(dtype),
            "cameras": self.io["camera"].to(dtype),
        }


def load_unet(config, original, dtype) -> MultiViewUNet:
    with torch.device("meta"):
        unet = build_unet(config)
    sources = {name: keys.unet_source(name, config) for name in unet.state_dict()}
    assert {source.name for source in sources.values()} == set(original)
    load_strictly(unet, {n: s.take(original[s.name]).to(dtype) for n, s in sources.items()})
    return MultiViewUNet(unet, config.num_views)


@pytest.fixture(scope="module", params=FIXTURES, ids=lambda path: path.name)
def fixture(request) -> Fixture:
    return Fixture(request.param)


@pytest.fixture(scope="module")
def first() -> Fixture:
    return Fixture(FIXTURES[0])


@needs_fixtures
@pytest.mark.parametrize(
    ("dtype", "name", "bound"),
    [(torch.float64, "out_fp64", 1e-9), (torch.float32, "out_fp32", 5e-4)],
)
@torch.no_grad()
def test_parity_with_the_original(fixture, dtype, name, bound):
    found = fixture.model(dtype)(**fixture.inputs(dtype))
    assert (found - fixture.io[name]).abs().max() < bound


@needs_fixtures
def test_our_cameras_are_the_original_ones(fixture):
    """azimuth_start is MVDream's a; ours is A = a - 90."""
    found = [
        camera_matrices(four_view_orbit(a - 90.0, e, radius=1.7, fov_deg=40, size_px=32))
        for e, a in zip(
            fixture.stated["elevation_deg"], fixture.stated["azimuth_start_deg"], strict=True
        )
    ]
    torch.testing.assert_close(torch.cat(found), fixture.io["camera"], atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    ("config", "size"),
    [
        (
            UNetConfig(
                model_channels=32,
                channel_mult=(2, 1, 3),
                num_res_blocks=1,
                attention_resolutions=(4, 1),
                num_head_channels=8,
                transformer_depth=2,
                context_dim=20,
                camera_dim=16,
                num_views=3,
            ),
            (8, 12),
        ),
        (
            UNetConfig(
                model_channels=64,
                channel_mult=(1, 1),
                num_res_blocks=3,
                attention_resolutions=(2,),
                num_head_channels=32,
                context_dim=12,
                num_views=2,
            ),
            (6, 4),
        ),
    ],
    ids=["three-levels", "two-levels"],
)
@torch.no_grad()
def test_parity_with_an_independent_float64_model_of_other_sizes(config, size):
    with torch.device("meta"):
        shapes = {n: tuple(v.shape) for n, v in build_unet(config).state_dict().items()}
    names = {keys.unet_source(n, config).name: shape for n, shape in shapes.items()}
    original = {name: value.double() for name, value in random_tensors(names, 11).items()}
    g = torch.Generator().manual_seed(3)
    batch = 2 * config.num_views
    inputs = {
        "latents": torch.randn(batch, 4, *size, generator=g, dtype=torch.float64),
        "timesteps": torch.tensor([981, 37]).repeat_interleave(config.num_views),
        "context": torch.randn(batch, 7, config.context_dim, generator=g, dtype=torch.float64),
        "cameras": torch.randn(batch, 16, generator=g, dtype=torch.float64),
    }
    found = load_unet(config, original, torch.float64)(**inputs)
    expected = reference.unet(
        original, *inputs.values(), head_width=config.num_head_channels, views=config.num_views
    )
    assert expected.std() > 0.1
    assert (found - expected).abs().max() < 1e-10


# Mutations: (model, inputs) -> changed in place. The joint attention's own check is bypassed.


def _modules(model, kind):
    return [m for m in model.modules() if type(m).__name__ == kind]


def _set_eps(modules, eps):
    for module in modules:
        module.eps = eps


def _resnet_norms(model):
    return [norm for m in _modules(model, "ResnetBlock2D") for norm in (m.norm1, m.norm2)]


def _tanh_gelu(model):
    for module in _modules(model, "GEGLU"):
        module.gelu = lambda gate: torch.nn.functional.gelu(gate, approximate="tanh")


def _double_heads(model):
    for module in _modules(model, "Attention"):
        module.heads *= 2


def _cameras(inputs, change):
    inputs["cameras"] = change(inputs["cameras"].reshape(-1, 4, 4).clone()).reshape(-1, 16)


def _opengl_world(matrices):
    """Undo rows (x, y, z) -> (x, -z, y)."""
    return matrices[:, [0, 2, 1, 3]] * matrices.new_tensor([1, 1, -1, 1])[:, None]


def _farther(matrices):
    matrices[:, :3, 3] *= 2.5
    return matrices


MUTATIONS = {
    "attention within a view": lambda m, i: install_joint_attention(m.unet, 1),
    "joint attention over two groups": lambda m, i: install_joint_attention(m.unet, 8),
    "joint attention over half a group": lambda m, i: install_joint_attention(m.unet, 2),
    "camera zeroed": lambda m, i: _cameras(i, torch.zeros_like),
    "camera transposed": lambda m, i: _cameras(i, lambda c: c.transpose(1, 2)),
    "camera in OpenGL's world": lambda m, i: _cameras(i, _opengl_world),
    "camera distance 2.5": lambda m, i: _cameras(i, _farther),
    "two cameras swapped": lambda m, i: _cameras(i, lambda c: c[[1, 0, *range(2, len(c))]]),
    "timestep plus one": lambda m, i: i.update(timesteps=i["timesteps"] + 1),
    "context of the other group": lambda m, i: i.update(context=i["context"].roll(4, 0)),
    "sin before cos": lambda m, i: setattr(m.unet.time_proj, "flip_sin_to_cos", False),
    "frequency shift": lambda m, i: setattr(m.unet.time_proj, "downscale_freq_shift", 1),
    "twice the heads": lambda m, i: _double_heads(m),
    "tanh GELU": lambda m, i: _tanh_gelu(m),
    "LayerNorm eps": lambda m, i: _set_eps(_modules(m, "LayerNorm"), 1e-6),
    "residual norm eps": lambda m, i: _set_eps(_resnet_norms(m), 1e-6),
    "transformer norm eps": lambda m, i: _set_eps(
        [t.norm for t in _modules(m, "Transformer2DModel")], 1e-5
    ),
    "final norm eps": lambda m, i: _set_eps([m.unet.conv_norm_out], 1e-6),
}


@needs_fixtures
@pytest.mark.parametrize("name", MUTATIONS)
@torch.no_grad()
def test_every_silent_mistake_breaks_parity(first, name):
    model, inputs = first.model(), first.inputs()
    MUTATIONS[name](model, inputs)
    found = model(**inputs)
    assert (found - first.io["out_fp64"]).abs().max() > 1e-6, "1000 times the bound of parity"


def test_a_model_without_joint_attention_is_refused():
    config = UNetConfig(model_channels=32, channel_mult=(1,), attention_resolutions=(1,),
                        num_res_blocks=1, num_head_channels=16, context_dim=8)  # fmt: skip
    with torch.device("meta"):
        unet = build_unet(config)
    assert check_joint_attention(unet, 4) == 4  # down 1, middle 1, up 2
    unet.set_attn_processor(AttnProcessor2_0())
    with pytest.raises(RuntimeError, match=r"attn1\.processor: expected joint attention over 4"):
        MultiViewUNet(unet, 4)


def test_a_model_without_numbers_cannot_run():
    config = UNetConfig(model_channels=32, channel_mult=(1,), attention_resolutions=(1,),
                        num_res_blocks=1, num_head_channels=16, context_dim=8)  # fmt: skip
    with torch.device("meta"):
        unet = build_unet(config)
        state = unet.state_dict()
    state.pop("conv_in.bias")
    with pytest.raises(RuntimeError, match=r"conv_in\.bias"):
        load_strictly(unet, state)
    with pytest.raises(RuntimeError, match="without values"):
        load_strictly(unet, unet.state_dict())
