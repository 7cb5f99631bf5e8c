"""The whole prior: loss and gradient against a float64 twin, memory plans, prompts, targets."""

import dataclasses

import pytest
import torch

pytest.importorskip("diffusers", reason="the extra gscomplete[mvdream] is not installed")
pytest.importorskip("transformers", reason="the extra gscomplete[mvdream] is not installed")

from gscomplete.errors import UserError
from gscomplete.priors.base import FourViews, Guidance, prior_identity
from gscomplete.priors.latent.guidance import NoiseSchedule
from gscomplete.priors.latent.networks import build_vae
from gscomplete.priors.latent.prior import draw_background, matte
from gscomplete.priors.latent.settings import PLANS, LatentPriorSettings, memory_plan
from gscomplete.priors.latent.tokenizer import Tokenizer
from gscomplete.priors.mvdream.cameras import camera_matrices
from gscomplete.priors.mvdream.config import PUBLISHED
from gscomplete.priors.mvdream.prior import NEGATIVE_PROMPT, mvdream_prior
from gscomplete.priors.mvdream.weights import open_weights
from gscomplete.views import four_view_orbit
from tests.builders.tiny_mvdream import TINY_VIEWS, component, original_tensors, write_original
from tests.priors.mvdream import reference

CPU = torch.device("cpu")
PROMPT = "a red mug"


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return open_weights(write_original(tmp_path_factory.mktemp("weights")))


def build(weights, cache=None, **knobs):
    settings = LatentPriorSettings(**knobs)
    return mvdream_prior(weights, CPU, settings, cache, views=TINY_VIEWS)


def renders(size: int = 32, seed: int = 0) -> FourViews:
    g = torch.Generator().manual_seed(seed)
    alpha = torch.rand(4, size, size, generator=g)
    color = torch.rand(4, size, size, 3, generator=g) * alpha[..., None]
    cameras = four_view_orbit(30, 10, radius=2, fov_deg=40, size_px=size)
    return FourViews(
        color.requires_grad_(), alpha.requires_grad_(), torch.zeros_like(alpha), cameras
    )


def generator(seed: int = 0) -> torch.Generator:  # 0: a white background
    return torch.Generator().manual_seed(seed)


def twin(views: FourViews, timestep: int, scales: Guidance, loss: str) -> torch.Tensor:
    """The distillation loss step by step, in float64, with none of the package's networks."""
    tensors = original_tensors()
    unet, vae, text = (component(tensors, name) for name in ("unet", "vae", "text"))
    g = generator()
    background = (torch.rand(3, generator=g)[:1] < 0.5).double()
    posterior = torch.randn(4, 4, 4, 4, generator=g).double()
    noise = torch.randn(4, 4, 4, 4, generator=g).double()
    image = views.color.double() + (1 - views.alpha.double())[..., None] * background
    mean, deviation = reference.vae_moments(vae, image.permute(0, 3, 1, 2) * 2 - 1, groups=4)
    latents = (mean + deviation * posterior) * 0.18215
    alpha_bar = NoiseSchedule.stable_diffusion().alphas_bar[timestep]
    a, s = alpha_bar**0.5, (1 - alpha_bar) ** 0.5
    with torch.no_grad():
        noisy = a * latents + s * noise
        cameras = camera_matrices(views.cameras).double()
        predicted = []
        for prompt in (PROMPT, NEGATIVE_PROMPT):
            ids = Tokenizer().encode(prompt).tensor()
            context = reference.text_tower(text, ids, heads=3).expand(4, -1, -1)
            timesteps = torch.full((4,), timestep)
            predicted.append(
                reference.unet(unet, noisy, timesteps, context, cameras, head_width=16, views=4)
            )
        e = predicted[1] + scales.text_scale * (predicted[0] - predicted[1])
        if loss == "epsilon":
            target = latents - (e - noise)
        else:
            clean, conditional = (noisy - s * e) / a, (noisy - s * predicted[0]) / a
            center = torch.zeros(1, 4, 4, 4).double()
            if scales.rescale_about == "background":
                plain = background.expand(1, 32, 32, 3).permute(0, 3, 1, 2)
                center = reference.vae_moments(vae, plain * 2 - 1, groups=4)[0] * 0.18215
            ratio = (conditional - center).std() / (clean - center).std()
            target = center + (clean - center) * (scales.rescale * ratio + 1 - scales.rescale)
    return 0.5 * (latents - target).square().sum() / 4


@pytest.mark.parametrize(
    ("loss", "timestep", "scales"),
    [
        ("x0", 490, None),
        ("x0", 980, Guidance(7.5, rescale=0.9)),
        ("x0", 490, Guidance(50.0, rescale=0.5, rescale_about="background")),
        ("x0", 20, Guidance(50.0)),
        ("epsilon", 300, Guidance(100.0)),
    ],
)
def test_loss_and_gradient_equal_the_float64_twin(weights, loss, timestep, scales):
    prior, views = build(weights, loss=loss), renders()
    conditioning = prior.condition(PROMPT)
    found = prior.distill(views, timestep, conditioning, generator(), guidance=scales)
    gradients = torch.autograd.grad(found, [views.color, views.alpha])
    expected = twin(views, timestep, scales or Guidance(50.0, rescale=0.5), loss)
    assert float(found.detach()) == pytest.approx(float(expected.detach()), rel=2e-4)
    for a, b in zip(
        gradients, torch.autograd.grad(expected, [views.color, views.alpha]), strict=True
    ):
        assert float((a - b).norm() / b.norm()) < 2e-3


def test_the_networks_are_frozen_and_the_denoiser_is_not_differentiated(weights, monkeypatch):
    prior, views = build(weights), renders()
    conditioning = prior.condition(PROMPT)
    network, recording = prior._denoiser._network, []
    original = network.forward
    monkeypatch.setattr(
        network, "forward", lambda *a: recording.append(torch.is_grad_enabled()) or original(*a)
    )
    prior.distill(views, 500, conditioning, generator()).backward()
    assert recording == [False]
    assert views.color.grad is not None
    for part in (network, prior._codec._vae):
        assert all(p.grad is None and not p.requires_grad for p in part.parameters())


def test_every_memory_plan_gives_the_same_loss_and_gradient(weights):
    results = []
    for memory in PLANS:
        prior, views = build(weights, memory=memory), renders()
        loss = prior.distill(views, 500, prior.condition(PROMPT), generator())
        gradient = torch.autograd.grad(loss, views.color)[0]
        results.append((float(loss.detach()), gradient))
    for loss, gradient in results[1:]:
        assert loss == pytest.approx(results[0][0], rel=1e-5)
        torch.testing.assert_close(gradient, results[0][1], rtol=1e-3, atol=1e-3)


def test_smaller_plans_keep_less_for_the_gradient(weights):
    kept = {}
    for memory in PLANS:
        prior, total = build(weights, memory=memory), [0]
        images = torch.rand(4, 3, 32, 32).requires_grad_()

        def count(t, total=total):
            total[0] += t.numel()
            return t

        with torch.autograd.graph.saved_tensors_hooks(count, lambda t: t):
            prior._codec.encode(images, torch.zeros(4, 4, 4, 4))
        kept[memory] = total[0]
    assert kept["8gb"] < kept["24gb"] / 10


def test_what_the_encoder_keeps_per_view_at_full_size():
    """The number that the memory plans are made from."""
    kept = {}

    def pack(tensor):
        kept[tensor.untyped_storage()._cdata] = tensor.untyped_storage().nbytes()
        return tensor

    with torch.device("meta"):
        encoder = build_vae(PUBLISHED.vae).encoder.to(torch.bfloat16)
        image = torch.empty(1, 3, 256, 256, dtype=torch.bfloat16, requires_grad=True)
        with torch.autograd.graph.saved_tensors_hooks(pack, lambda t: t):
            encoder(image)
    weights = {value.untyped_storage()._cdata for value in encoder.parameters()}
    total = sum(size for storage, size in kept.items() if storage not in weights)
    assert total / 2**30 == pytest.approx(0.38, abs=0.02)


def test_plans_are_chosen_by_memory(monkeypatch):
    class Properties:
        total_memory = 0

    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda device: Properties)
    for gib, plan in ((7.6, "8gb"), (11.8, "8gb"), (15.7, "16gb"), (23.5, "24gb"), (139, "24gb")):
        Properties.total_memory = int(gib * 2**30)
        assert memory_plan("auto", torch.device("cuda")) == PLANS[plan]
    assert memory_plan("8gb", CPU) == PLANS["8gb"]


def test_guidance_of_one_takes_a_single_pass(weights, monkeypatch):
    prior, views = build(weights), renders()
    conditioning = prior.condition(PROMPT)
    batches = []
    original = prior._denoiser._network.forward
    monkeypatch.setattr(
        prior._denoiser._network, "forward", lambda x, *a: batches.append(len(x)) or original(x, *a)
    )
    prior.distill(views, 500, conditioning, generator(), guidance=Guidance(1.0))
    prior.distill(views, 500, conditioning, generator())
    assert batches == [4, 8]


def test_other_resolutions_are_resized_with_gradient(weights):
    prior = build(weights)
    for size in (16, 48):
        views = renders(size)
        loss = prior.distill(views, 500, prior.condition(PROMPT), generator())
        gradient = torch.autograd.grad(loss, views.color)[0]
        assert gradient.shape == views.color.shape
        assert torch.isfinite(gradient).all()
        assert float(gradient.abs().amax(dim=(1, 2, 3)).min()) > 0, "every view has a gradient"


def test_knobs_change_what_they_say(weights):
    views = renders()

    def loss(**knobs):
        prior = build(weights, **knobs)
        conditioning = prior.condition(PROMPT)
        return float(prior.distill(views, 500, conditioning, generator()).detach())

    default = loss()
    assert loss() == default
    for knobs in (
        {"guidance": 7.5},
        {"rescale": 0.0},
        {"loss": "epsilon"},
        {"background": "random"},
        {"front_azimuth_deg": 90.0},
        {"sample_posterior": False},
    ):
        assert loss(**knobs) != pytest.approx(default, rel=1e-6), knobs
    assert loss(guidance=50.0, rescale=0.5) == default
    for bad in ({"rescale": 1.5}, {"guidance": -1.0}, {"front_azimuth_deg": float("nan")}):
        with pytest.raises(UserError, match=next(iter(bad))):
            LatentPriorSettings(**bad)


def test_backgrounds():
    def drawn(choice):
        return torch.stack([draw_background(choice, generator(seed)) for seed in range(64)])

    both = drawn("black_or_white")
    assert set(both.flatten().tolist()) == {0.0, 1.0}
    assert (both == both[:, :1]).all()
    assert 16 < both[:, 0].sum() < 48
    assert drawn("black").max() == 0
    assert drawn("white").min() == 1
    assert len(set(drawn("random").flatten().tolist())) > 180


def test_prompts_are_remembered_on_disk(weights, tmp_path):
    loads = []
    counted = dataclasses.replace(build(weights, tmp_path / "cache")._encoder)
    counted = dataclasses.replace(
        counted, load_tower=lambda: loads.append(1) or weights.text_tower()
    )
    first = counted.encode([PROMPT, NEGATIVE_PROMPT])
    again = counted.encode([NEGATIVE_PROMPT, PROMPT])
    assert loads == [1]
    assert torch.equal(first[0], again[1])
    assert torch.equal(first[1], again[0])
    files = sorted((tmp_path / "cache").iterdir())
    assert [file.suffix for file in files] == [".safetensors"] * 2
    # another tower, a damaged file or a folder that cannot be written never give a wrong result
    other = dataclasses.replace(counted, tower_digest="another")
    other.encode([PROMPT])
    assert len(loads) == 2
    files[0].write_bytes(b"damaged")
    assert all(
        torch.equal(a, b)
        for a, b in zip(counted.encode([PROMPT, NEGATIVE_PROMPT]), first, strict=True)
    )
    assert len(loads) == 3
    nowhere = dataclasses.replace(counted, cache=tmp_path / "cache" / files[0].name / "x")
    assert torch.equal(nowhere.encode([PROMPT])[0], first[0])


def test_negative_prompt_default_and_none(weights):
    prior = build(weights)
    default, none = prior.condition(PROMPT), prior.condition(PROMPT, "")
    assert not torch.equal(default.negative_context, none.negative_context)
    assert torch.equal(
        default.negative_context, prior.condition(PROMPT, NEGATIVE_PROMPT).negative_context
    )
    assert torch.equal(none.negative_context, prior.condition("").context)
    assert any("negative prompt" in line for line in default.report)
    assert any("too long" in line for line in prior.condition("mug " * 99).report)
    assert len(NEGATIVE_PROMPT.split(", ")) == 19


def test_reconstruct_gives_valid_targets(weights):
    prior, views = build(weights), renders()
    conditioning = prior.condition(PROMPT)
    for timestep in (300.0, 999.0):
        color, alpha = prior.reconstruct(views, timestep, conditioning, generator(), num_steps=3)
        assert color.shape == (4, 32, 32, 3)
        assert alpha.shape == (4, 32, 32)
        assert not color.requires_grad
        assert (color >= 0).all()
        assert (color <= alpha[..., None] + 1e-6).all()
        assert (alpha <= 1).all()
        again = prior.reconstruct(views, timestep, conditioning, generator(), num_steps=3)
        assert torch.equal(again[0], color)


@pytest.mark.parametrize("background", [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.5, 0.5, 0.5)])
def test_matte_finds_what_is_not_background(background):
    side = 64
    inside = torch.zeros(side, side)
    inside[16:48, 16:48] = 1
    red = torch.tensor([0.8, 0.1, 0.2])[:, None, None]
    ground = torch.tensor(background)[:, None, None]
    image = (inside * red + (1 - inside) * ground).expand(2, -1, -1, -1)
    color, alpha = matte(image)
    torch.testing.assert_close(alpha, inside.expand(2, -1, -1))
    torch.testing.assert_close(color, (inside * red).permute(1, 2, 0).expand(2, -1, -1, -1))


@pytest.mark.parametrize("timestep", [-1.0, 1000.0, float("nan")])
def test_timesteps_outside_the_schedule_are_refused(weights, timestep):
    prior = build(weights)
    with pytest.raises(ValueError, match="timestep"):
        prior.distill(renders(), timestep, prior.condition(PROMPT), generator())


def test_identity_tells_weights_and_deciding_knobs(weights):
    identity = prior_identity(build(weights))
    assert identity["name"] == "mvdream"
    assert identity["weights"] == weights.fingerprint()
    assert identity["settings"]["loss"] == "x0"
    assert identity["settings"]["guidance"] == 50.0
    assert identity["settings"]["rescale"] == 0.5
    assert identity["settings"]["negative_prompt"] == NEGATIVE_PROMPT
    assert prior_identity(build(weights, guidance=50.0)) == identity
    assert prior_identity(build(weights, memory="8gb")) == identity
    assert prior_identity(build(weights, loss="epsilon")) != identity


def test_half_precision_is_close(weights):
    views = renders()
    gradients = []
    for precision in ("float32", "bfloat16", "float16"):
        prior = build(weights, precision=precision, vae_precision=precision)
        loss = prior.distill(views, 500, prior.condition(PROMPT), generator())
        gradients.append(torch.autograd.grad(loss, views.color)[0].flatten())
    for gradient in gradients[1:]:
        assert float(torch.cosine_similarity(gradients[0], gradient, dim=0)) > 0.98


def test_networks_compile_without_a_break(weights):
    """With the machine code left out: the graph is whole and computes the same."""
    prior, views = build(weights), renders()
    network = prior._denoiser._network
    compiled = torch.compile(network, backend="eager", fullgraph=True)
    g = torch.Generator().manual_seed(0)
    inputs = (
        torch.randn(8, 4, 4, 4, generator=g),
        torch.full((8,), 500),
        torch.randn(8, 77, 24, generator=g),
        torch.randn(8, 16, generator=g),
    )
    with torch.no_grad():
        torch.testing.assert_close(compiled(*inputs), network(*inputs))
    expected = prior.distill(views, 500, prior.condition(PROMPT), generator())
    prior._codec._encoder = torch.compile(
        prior._codec._vae.encoder, backend="eager", fullgraph=True
    )
    found = prior.distill(views, 500, prior.condition(PROMPT), generator())
    torch.testing.assert_close(found, expected)
    torch.autograd.grad(found, views.color)


def test_tiny_autoencoder_stands_in(weights, tmp_path):
    import json

    import diffusers
    from safetensors.torch import save_file

    torch.manual_seed(0)
    sizes = {"encoder_block_out_channels": (8,) * 4, "decoder_block_out_channels": (8,) * 4}
    tiny = diffusers.AutoencoderTiny(**sizes)
    config = {"_class_name": "AutoencoderTiny"} | {k: list(v) for k, v in sizes.items()}
    (tmp_path / "config.json").write_text(json.dumps(config))
    path = tmp_path / "diffusion_pytorch_model.safetensors"
    save_file(tiny.state_dict(), path)
    prior, views = build(weights, tiny_vae=tmp_path), renders()
    images = torch.rand(4, 3, 32, 32) * 2 - 1
    with torch.no_grad():
        expected = tiny.encode(images).latents
    torch.testing.assert_close(prior._codec.encode(images, None), expected)
    loss = prior.distill(views, 500, prior.condition(PROMPT), generator())
    assert torch.autograd.grad(loss, views.color)[0].abs().max() > 0
    color, _ = prior.reconstruct(views, 300, prior.condition(PROMPT), generator(), num_steps=1)
    assert color.shape == (4, 32, 32, 3)
    state = tiny.state_dict()
    state.pop("encoder.layers.0.bias")
    save_file(state, path)
    with pytest.raises(UserError, match=r"missing 1: encoder\.layers\.0\.bias"):
        build(weights, tiny_vae=tmp_path)
    (tmp_path / "config.json").write_text('{"_class_name": "AutoencoderKL"}')
    with pytest.raises(UserError, match="AutoencoderTiny"):
        build(weights, tiny_vae=tmp_path)
