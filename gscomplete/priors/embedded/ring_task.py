"""One ring of four views and what it is denoised under: P, a known shape, words, guidance.

Conventions
-----------
* Images are those of ``inputs``: premultiplied RGBA in [-1, 1], S pixels wide.
* Without P in sight the network sees nothing in its place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.priors.base import FourViews, Guidance
from gscomplete.priors.embedded.conditioning import EmbeddedConditioning
from gscomplete.priors.embedded.diffusion import guided_x0, x0_from_v
from gscomplete.priors.embedded.inputs import input_map
from gscomplete.priors.embedded.model import INPUT_CHANNELS, VIEWS
from gscomplete.priors.embedded.rays import ring_numbers


@dataclass(frozen=True, slots=True)
class RingTask:
    """What is to be denoised under which conditions."""

    ring: Tensor  # [3]
    mapped: Tensor | None  # [4, 5, S, S] P; None = withheld
    shape: Tensor  # [4, 2, S, S]
    conditioning: EmbeddedConditioning
    guidance: Guidance

    def denoise(
        self,
        network: Callable[..., Tensor],
        noisy: Tensor,  # [4, 4, S, S]
        timestep: float,
    ) -> Tensor:  # [4, 4, S, S]
        """Return the guided x0, within the range of images.

        Args:
            network: a ``FourViewDenoiser`` in evaluation mode, on the device of the images.
            noisy: the ring.
            timestep: of its noise.
        """
        nothing = noisy.new_zeros(VIEWS, INPUT_CHANNELS, *noisy.shape[-2:])

        def denoise(passes: list[tuple[bool, bool]]) -> list[Tensor]:
            count = len(passes)
            maps = [nothing if self.mapped is None or not seen else self.mapped
                    for seen, _ in passes]  # fmt: skip
            words = self.conditioning
            tokens = [words.tokens if told else words.negative_tokens for _, told in passes]
            x_t = noisy[None].expand(count, -1, -1, -1, -1)
            at = noisy.new_full((count,), timestep)
            v = network(
                x_t,
                torch.stack(maps),
                self.shape.expand(count, -1, -1, -1, -1),
                at,
                self.ring.expand(count, -1),
                torch.stack(tokens).to(noisy.device),
            )
            return list(x0_from_v(x_t, v, at).split(1))

        x0 = guided_x0(
            denoise,
            has_input=self.mapped is not None,
            has_text=self.conditioning.has_text,
            input_scale=self.guidance.input_scale,
            text_scale=self.guidance.text_scale,
            rescale=self.guidance.rescale,
        )
        return x0[0].clamp(-1, 1)


def ring_task(
    views: FourViews,
    conditioning: EmbeddedConditioning,
    input_views: FourViews | None,
    guidance: Guidance,
    size_px: int,
    device: torch.device,
) -> RingTask:
    """Gather what stays the same over the denoising steps of one ring.

    Args:
        views: the ring.
        conditioning: of the prompt.
        input_views: P from the same views; None = withheld.
        guidance: scales.
        size_px: of the network's images.
        device: where the network runs.
    """
    ring = ring_numbers(views.cameras)
    radius = float(ring[1])
    mapped = None
    if input_views is not None:
        color, alpha, depth = (
            x.detach() for x in (input_views.color, input_views.alpha, input_views.depth)
        )
        mapped = input_map(color, alpha, depth, radius, size_px).to(device)
    shape = conditioning.shape_map(views, radius, size_px).to(device)
    return RingTask(ring.to(device), mapped, shape, conditioning, guidance)
