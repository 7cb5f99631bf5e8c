"""Time the paper's step with full-size MVDream on a GPU, against a plain loop, and check gsplat.

``python -m recipes.benchmarks.mvdream_gpu [--objects A.ply B.ply C.ply] [--json OUT]`` fills the
published architecture with random numbers (weights decide nothing about speed) and reports, for
the completion loop at the paper's settings: milliseconds per step and where they go, the share of
the measured matrix peak, peak memory, minutes for 6,000 steps; the same for a plain loop; and
gsplat's errors against the float64 renderer on the given objects. Each result is written as soon as
it is measured, so a run that is stopped keeps it. ``--reduced --device cpu`` runs everything at
reduced width without a GPU, only to check that it works; those times mean nothing.

The plain loop is what a first implementation does: float32, conditional and unconditional images
one after the other, O and P rendered every step with gradients for all of their splats, no
compiling.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import torch
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from gscomplete.completion.losses import preservation_loss
from gscomplete.completion.optimise import Optimisation
from gscomplete.completion.presets import PAPER
from gscomplete.completion.start import start_splats
from gscomplete.priors.base import FourViews, PriorViews
from gscomplete.priors.latent.networks import VAEConfig, build_vae
from gscomplete.priors.latent.prior import LatentConditioning, LatentPrior
from gscomplete.priors.latent.settings import Compile, LatentPriorSettings, Memory
from gscomplete.priors.mvdream.config import PUBLISHED, MVDreamConfig, UNetConfig
from gscomplete.priors.mvdream.model import MultiViewUNet, build_unet
from gscomplete.priors.mvdream.prior import MVDREAM_VIEWS, mvdream_prior
from gscomplete.render import render
from gscomplete.render.dispatch import choose_render_device
from gscomplete.render.partial_views import PartialViews
from gscomplete.splats import Splats, concatenate, read_splats
from gscomplete.splats.filters import usable_rows
from gscomplete.util.atomic import atomic_path
from gscomplete.util.device import choose_device
from gscomplete.views import ViewDistribution, four_view_orbit
from recipes.benchmarks.renderer.scenes import surface_discs
from recipes.entry_point import start

REDUCED = MVDreamConfig(
    UNetConfig(model_channels=32, channel_mult=(1, 1), num_res_blocks=1, num_head_channels=32),
    VAEConfig(base_channels=8, channel_mult=(1, 1, 1, 1), num_res_blocks=1, norm_groups=4),
)
REDUCED_VIEWS = PriorViews(40.0, (1.3, 1.6), (0.0, 30.0), 32)


@dataclass(frozen=True)
class Options:
    """Time full-size MVDream with random weights at the paper's settings."""

    device: str = "auto"
    """auto, cuda, cuda:1 or cpu."""
    partial_splats: int = 60_000
    """Splats of P (the paper: 20,000 to 100,000)."""
    new_splats: int = 100_000
    """New splats (the paper ends with 100,000 to 200,000)."""
    steps: int = 60
    """Timed steps after ten untimed ones."""
    memory: Memory = "auto"
    """Memory plan of our loop."""
    compile: Compile = "cuda-graphs"
    """How our loop compiles the networks."""
    plain: bool = True
    """Time the plain loop too."""
    objects: tuple[Path, ...] = ()
    """Splat files on which gsplat is compared with the float64 renderer."""
    reduced: bool = False
    """Reduced width and sizes, to see that the script runs."""
    json: Path | None = None
    """Write the numbers to this file."""


@dataclass
class Clock:
    """Seconds by part; the device is synchronised before and after each part."""

    device: torch.device
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Add the time of a block to a part."""
        start = self.now()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + self.now() - start

    def now(self) -> float:
        """Return the time when everything before is done."""
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        return time.perf_counter()

    def wrapped(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that adds its time to a part."""

        def timed(*arguments: Any, **more: Any) -> Any:
            with self.part(name):
                return function(*arguments, **more)

        return timed


@dataclass(frozen=True)
class RendererErrors:
    """Differences of gsplat from the float64 renderer."""

    color: float
    depth: float
    alpha: float
    gradient_relative: dict[str, float]


class RandomWeights:
    """Stands in for opened weights: the networks with random numbers, for timing alone."""

    def __init__(self, config: MVDreamConfig, device: torch.device) -> None:
        """Take the sizes and where the networks are made."""
        self.config, self._device = config, device

    def unet(self) -> MultiViewUNet:
        """Make the denoiser."""
        with self._device:
            unet = build_unet(self.config.unet)
        return MultiViewUNet(unet, self.config.unet.num_views)

    def vae(self) -> Any:
        """Make the autoencoder."""
        with self._device:
            return build_vae(self.config.vae)

    def text_tower(self) -> Any:
        """Refuse: prompts are not timed."""
        raise NotImplementedError("the benchmark gives embeddings, not prompts")

    def fingerprint(self) -> str:
        """Say what these are."""
        return "random"

    text_fingerprint = fingerprint


def random_prior(options: Options, device: torch.device, knobs: LatentPriorSettings) -> LatentPrior:
    """Return MVDream's prior with random weights."""
    config = REDUCED if options.reduced else PUBLISHED
    weights: Any = RandomWeights(config, device)
    views = REDUCED_VIEWS if options.reduced else MVDREAM_VIEWS
    return mvdream_prior(weights, device, knobs, views=views)


def random_conditioning(options: Options, device: torch.device) -> LatentConditioning:
    """Return embeddings of no prompt in particular."""
    text = (REDUCED if options.reduced else PUBLISHED).text
    g = torch.Generator().manual_seed(0)
    one, other = (torch.randn(text.length, text.width, generator=g) for _ in range(2))
    return LatentConditioning(one.to(device), other.to(device), ())


def half_knot(count: int) -> Splats:
    """Return the half of a torus knot that faces +x, as P."""
    together = surface_discs(None, 2 * count)
    return together.select(together.means[:, 0].argsort(descending=True)[:count])


def completion_job(
    options: Options, prior: LatentPrior, render_device: torch.device
) -> Optimisation:
    """Set up the completion loop at the paper's settings with splats in place."""
    settings = dataclasses.replace(PAPER, new_splats=options.new_splats, warmup_steps=0)
    partial, views = half_knot(options.partial_splats), ViewDistribution(0.0, 15.0)
    conditioning = random_conditioning(options, prior._device)
    start = start_splats(partial, prior, conditioning, views, settings).splats
    return Optimisation(partial, start, prior, conditioning, views, settings, render_device)


def plain_step(job: Optimisation, prior: LatentPrior) -> None:
    """Take one step of the plain loop (see the module's description)."""
    splats, partial = job.parameters.splats(), job.partial
    partial = Splats(**{n: v.clone().requires_grad_() for n, v in partial.fields()})
    views = prior.views
    radius = sum(views.radius_range()) / 2
    size_px = views.resolution_px
    ring = four_view_orbit(0.0, 15.0, radius=radius, fov_deg=views.fov_deg, size_px=size_px)
    drawn = render(concatenate([partial, splats]), ring)
    g = torch.Generator().manual_seed(job.step_number)
    loss = prior.distill(FourViews.from_render(drawn, ring), 490.0, job._conditioning, g)
    angles = job.views.sample(0, job.step_number, 1)
    camera = job.views.cameras(angles, size_px)
    together, alone = render(concatenate([partial, splats]), camera), render(partial, camera)
    black = torch.zeros(3, device=together.color.device)
    loss = loss.to(black.device) + 2.0 * preservation_loss(together, alone, black, masked=True)
    loss.backward()
    job.parameters.step(0.0)
    job.step_number += 1


def time_steps(step: Callable[[], object], count: int, clock: Clock) -> float:
    """Return milliseconds per step, the first ten not counted."""
    for _ in range(10 if count >= 10 else 1):
        step()
    start = clock.now()
    for _ in range(count):
        step()
    return (clock.now() - start) / count * 1e3


def time_parts(job: Optimisation, prior: LatentPrior, count: int, clock: Clock) -> dict[str, float]:
    """Return milliseconds per step by part; waiting between them makes the sum a bit longer."""
    denoiser, codec = prior._denoiser, prior._codec
    drawn = clock.wrapped("render forward", PartialViews.together)
    with (
        mock.patch.object(prior, "_denoiser", _Timed(denoiser, clock.wrapped("unet", denoiser))),
        mock.patch.object(codec, "encode", clock.wrapped("vae forward", codec.encode)),
        mock.patch.object(PartialViews, "together", drawn),
        mock.patch.object(Tensor, "backward", clock.wrapped("backward (all)", Tensor.backward)),
        clock.part("step"),
    ):
        for _ in range(count):
            job.step()
    parts = {name: seconds / count * 1e3 for name, seconds in clock.seconds.items()}
    parts["vae backward"] = vae_backward_ms(prior, count, clock)
    parts["render backward"] = parts["backward (all)"] - parts["vae backward"]
    named = ("unet", "vae forward", "render forward", "backward (all)")
    parts["rest"] = parts["step"] - sum(parts[name] for name in named)
    return parts


class _Timed:
    """A denoiser that is called through a timer and is otherwise itself."""

    def __init__(self, denoiser: Any, timed: Callable[..., Any]) -> None:
        self._timed, self.schedule, self.group = timed, denoiser.schedule, denoiser.group

    def __call__(self, *arguments: Any) -> Any:
        return self._timed(*arguments)


def vae_backward_ms(prior: LatentPrior, count: int, clock: Clock) -> float:
    """Time the encoder's gradient alone."""
    size_px = prior.views.resolution_px
    images = torch.rand(4, 3, size_px, size_px, device=prior._device, requires_grad=True)
    seconds = 0.0
    for _ in range(count):
        latents = prior._codec.encode(images * 2 - 1, None)
        start = clock.now()
        latents.sum().backward()
        seconds += clock.now() - start
    return seconds / count * 1e3


def network_flops(job: Optimisation) -> int:
    """Count the floating-point operations of one step's networks, forward and backward."""
    with FlopCounterMode(display=False) as counter:
        job.step()
    return counter.get_total_flops()


def matrix_peak_flops(device: torch.device, dtype: torch.dtype, side: int) -> float:
    """Measure the device's rate of matrix multiplication on random numbers, per second."""
    clock = Clock(device)
    a, b = (torch.randn(side, side, device=device, dtype=dtype) for _ in range(2))
    repeats = 20
    milliseconds = time_steps(lambda: a @ b, repeats, clock)
    return 2 * side**3 / (milliseconds / 1e3)


def renderer_parity(splats: Splats, size_px: int = 128) -> RendererErrors:
    """Compare gsplat with the float64 renderer: largest errors, relative errors of gradients."""
    cameras = four_view_orbit(30, 15, radius=2.2, fov_deg=40, size_px=size_px)[0]
    g = torch.Generator().manual_seed(0)
    weights = torch.randn(1, size_px, size_px, 3, generator=g)
    images, gradients = [], []
    for backend, device in (("cuda", "cuda"), ("reference", "cpu")):
        made = Splats(**{n: v.to(device).clone().requires_grad_() for n, v in splats.fields()})
        drawn = render(made, cameras, backend=backend)  # type: ignore[arg-type]
        loss = (drawn.color * weights.to(drawn.color)).sum() + drawn.alpha.square().sum()
        loss.backward()
        images.append([x.detach().double().cpu() for x in (drawn.color, drawn.depth, drawn.alpha)])
        gradients.append({n: v.grad.double().cpu() for n, v in made.fields() if v.grad is not None})
    color, depth, alpha = (float((a - b).abs().max()) for a, b in zip(*images, strict=True))
    relative = {
        name: float((gradients[0][name] - value).norm() / value.norm().clamp_min(1e-300))
        for name, value in gradients[1].items()
    }
    return RendererErrors(color, depth, alpha, relative)


def read_object(path: Path) -> Splats:
    """Read a splat file into a box of side 1 about the origin."""
    splats = read_splats(path).splats
    splats = splats.select(usable_rows(splats)[0])
    low, high = splats.bounds()
    side = (high - low).max()
    return dataclasses.replace(
        splats, means=(splats.means - (low + high) / 2) / side, scales=splats.scales / side
    )


def measure(options: Options) -> Iterator[dict[str, Any]]:
    """Run everything that was asked for; give numbers as they come."""
    device = choose_device(options.device)
    render_device, note = choose_render_device(options.device, device)
    clock = Clock(device)
    yield {"device": _device_name(device), "note": note}
    dtype = torch.bfloat16 if device.type == "cuda" else torch.float32
    knobs = LatentPriorSettings(memory=options.memory, compile=options.compile)
    prior = random_prior(options, device, knobs)
    job = completion_job(options, prior, render_device)
    _reset_peak(device)
    ours = time_steps(job.step, options.steps, clock)
    yield {
        "ours_ms": ours,
        "ours_minutes_for_6000_steps": ours * 6000 / 6e4,
        "ours_peak_gib": _peak_gib(device),
    }
    yield {"ours_parts_ms": time_parts(job, prior, max(1, options.steps // 4), Clock(device))}
    plain_prior = random_prior(options, device, dataclasses.replace(knobs, compile="off"))
    flops = network_flops(completion_job(options, plain_prior, render_device))
    del plain_prior
    peak = matrix_peak_flops(device, dtype, 512 if options.reduced else 8192)
    yield {
        "network_tflop_per_step": flops / 1e12,
        "matrix_peak_tflops": peak / 1e12,
        "share_of_peak": flops / (ours / 1e3) / peak,
    }
    if options.plain:
        del prior, job
        plain = measure_plain(options, device, render_device)
        yield plain | {"times_faster": plain["plain_ms"] / ours}
    parity = {}
    for path in options.objects:
        parity[path.name] = dataclasses.asdict(renderer_parity(read_object(path)))
        yield {"gsplat_errors": parity}


def measure_plain(
    options: Options, device: torch.device, render_device: torch.device
) -> dict[str, Any]:
    """Time the plain loop."""
    knobs = LatentPriorSettings(
        precision="float32", vae_precision="float32", memory="24gb", channels_last=False
    )
    prior = random_prior(options, device, knobs)
    prior._plan = dataclasses.replace(prior._plan, split_guidance=True)
    job = completion_job(options, prior, render_device)
    _reset_peak(device)
    milliseconds = time_steps(
        lambda: plain_step(job, prior), max(1, options.steps // 3), Clock(device)
    )
    return {"plain_ms": milliseconds, "plain_peak_gib": _peak_gib(device)}


def main(options: Options) -> None:
    """Measure and report."""
    if options.reduced:
        options = dataclasses.replace(options, partial_splats=500, new_splats=500)
    found: dict[str, Any] = {}
    for numbers in measure(options):
        found |= numbers
        sys.stdout.write(json.dumps(numbers, indent=1) + "\n")
        sys.stdout.flush()
        if options.json:
            with atomic_path(options.json) as temporary:
                temporary.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def _device_name(device: torch.device) -> str:
    return torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu"


def _reset_peak(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)


def _peak_gib(device: torch.device) -> float | None:
    return torch.cuda.max_memory_allocated(device) / 2**30 if device.type == "cuda" else None


if __name__ == "__main__":
    start(main, Options, __doc__)
