"""Every knob of priors that are latent diffusion models, and the memory plans.

Conventions
-----------
* Sizes in bytes are GiB = 2^30; ``*_views`` counts images of a ring of four.
* ``auto`` precision: bfloat16 where the device multiplies it in hardware, else float16 on a GPU
  (the autoencoder, whose gradient float16 would lose, float32), else float32.
* Noise schedules, guidance, latents and losses are float32 whatever the networks are.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from gscomplete.errors import UserError

if TYPE_CHECKING:
    import torch

Loss = Literal["x0", "epsilon"]
"""``x0``: half the squared distance to the denoised latents (the paper's Equation 2 as
MVDream-threestudio computes it). ``epsilon``: DreamGaussian's score distillation without a weight
of t. Their gradients differ by s/a (13.0 at t = 980, 0.14 at t = 20): learning rates that suit one
do not suit the other."""

Background = Literal["black_or_white", "random", "black", "white"]
"""``black_or_white``: one of the two per step, as DreamGaussian. ``random``: any colour per step.
The four views share it."""

Precision = Literal["auto", "float32", "bfloat16", "float16"]

Memory = Literal["auto", "8gb", "16gb", "24gb"]
"""Plan for a device with so much memory; ``auto`` = the largest plan that fits it."""

Compile = Literal["off", "default", "cuda-graphs"]
"""``default``: torch.compile. ``cuda-graphs``: with CUDA graphs for the UNet too."""


@dataclass(frozen=True, slots=True)
class MemoryPlan:
    """What to trade for memory."""

    device_gib: float
    """Least memory of the device the plan is for."""
    vae_views: int
    """Views that the encoder takes at once."""
    recompute: bool
    """Forget the encoder's activations and compute them again for the gradient: about a third
    more time in the encoder, a fraction of its memory."""
    split_guidance: bool
    """Run conditional and unconditional images one after the other instead of in one batch."""


PLANS: dict[str, MemoryPlan] = {
    "8gb": MemoryPlan(0.0, vae_views=1, recompute=True, split_guidance=True),
    "16gb": MemoryPlan(12.0, vae_views=2, recompute=False, split_guidance=False),
    "24gb": MemoryPlan(20.0, vae_views=4, recompute=False, split_guidance=False),
}
"""Computed from shapes, not measured: MVDream's UNet is 1.6 GiB in 16 bits, and the encoder keeps
0.38 GiB per view for the gradient in bfloat16 (0.74 in float32), one view's with ``recompute``."""


@dataclass(frozen=True)
class LatentPriorSettings:
    """Settings of priors that are latent diffusion models (mvdream, or a diffusers folder)."""

    loss: Loss = "x0"
    """Form of the distillation loss."""
    guidance: float | None = None
    """Guidance scale; None = the prior's default (MVDream: 50, single-view models: 100)."""
    rescale: float | None = None
    """How far to rescale guided images to the contrast of the conditional ones, 0 to 1, against
    oversaturation and floaters (``x0`` only); None = 0.5."""
    background: Background = "black_or_white"
    """Background of the prior's input renders."""
    front_azimuth_deg: float = 0.0
    """Azimuth in the object frame that MVDream takes for the front (its +x)."""
    sample_posterior: bool = True
    """Sample the autoencoder's posterior as the reference does; False = its mean."""
    tiny_vae: Path | None = None
    """Folder of an ``AutoencoderTiny`` (TAESD) that replaces the encoder: faster, but with an
    approximate gradient; None = the exact encoder."""
    precision: Precision = "auto"
    """Number type of the UNet."""
    vae_precision: Precision = "auto"
    """Number type of the autoencoder."""
    memory: Memory = "auto"
    """GPU memory to plan for; auto = the largest plan that fits the device."""
    channels_last: bool = True
    """On a GPU, store images with channels last, which is faster for convolutions."""
    compile: Compile = "off"
    """Compile the networks on a GPU: takes a minute at the start, then steps are faster."""

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            UserError: a value is outside its range.
        """
        if self.rescale is not None and not 0 <= self.rescale <= 1:
            raise UserError(f"rescale: expected 0 to 1, found {self.rescale:g}")
        if self.guidance is not None and not 0 <= self.guidance <= 1e4:
            raise UserError(f"guidance: expected 0 to 10000, found {self.guidance:g}")
        if not -1e6 <= self.front_azimuth_deg <= 1e6:
            raise UserError(f"front_azimuth_deg: expected degrees, found {self.front_azimuth_deg}")


def memory_plan(memory: Memory, device: torch.device) -> MemoryPlan:
    """Return the plan asked for, or the largest that fits the device (``24gb`` on a CPU)."""
    import torch

    if memory != "auto":
        return PLANS[memory]
    if device.type != "cuda":
        return PLANS["24gb"]
    gib = torch.cuda.get_device_properties(device).total_memory / 2**30
    return max(
        (plan for plan in PLANS.values() if plan.device_gib <= gib), key=lambda p: p.device_gib
    )


def unet_dtype(precision: Precision, device: torch.device) -> torch.dtype:
    """Return the number type of the UNet."""
    import torch

    if precision != "auto":
        return _named(precision)
    if device.type != "cuda":
        return torch.float32
    # Turing and older emulate bfloat16, and multiply float16 themselves.
    is_native = torch.cuda.is_bf16_supported(including_emulation=False)
    return torch.bfloat16 if is_native else torch.float16


def vae_dtype(precision: Precision, device: torch.device) -> torch.dtype:
    """Return the number type of the autoencoder; ``auto`` is never float16."""
    import torch

    if precision != "auto":
        return _named(precision)
    wide = unet_dtype("auto", device)
    return wide if wide == torch.bfloat16 else torch.float32


def _named(precision: Precision) -> torch.dtype:
    import torch

    dtype = getattr(torch, precision)
    assert isinstance(dtype, torch.dtype)
    return dtype
