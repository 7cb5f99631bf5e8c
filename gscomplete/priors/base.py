"""The interface of priors: what the completion loop may ask of a model of objects.

Conventions
-----------
* A prior sees rings of four views: one elevation, one radius, one field of view, azimuth
  increasing by 90 degrees from view to view (``gscomplete.views.cameras.four_view_orbit``).
* Images are in [0, 1] at whatever size they were rendered; the prior resizes them to its own
  resolution, differentiably. ``color`` is premultiplied by alpha, which is the same as rendered
  over black.
* Lengths are in units of the object frame: the object's largest side is about 1.
* A timestep runs from 0 (clean) to ``num_timesteps - 1`` (pure noise) and may be fractional.
* Random numbers come only from the generator that is passed in.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import torch
from torch import Tensor

from gscomplete.render.record import Render
from gscomplete.shape.mirror_plane import ChosenMirror, MirrorWish
from gscomplete.splats.record import Splats
from gscomplete.util.jsonio import to_json
from gscomplete.views.cameras import Cameras, radius_to_fit
from gscomplete.views.distribution import ViewDistribution


@dataclass(frozen=True, slots=True)
class FourViews:
    """Renders of one ring of four views."""

    color: Tensor  # [4, H, W, 3] in [0, 1], premultiplied (over black)
    alpha: Tensor  # [4, H, W] in [0, 1]
    depth: Tensor  # [4, H, W] camera-space z of what is seen, 0 where alpha is 0
    cameras: Cameras  # 4 cameras, azimuth increasing by 90 degrees

    def __post_init__(self) -> None:
        """Check shapes.

        Raises:
            ValueError: the fields do not describe four square views of one size.
        """
        height, width = self.alpha.shape[-2:]
        expected = {"color": (4, height, width, 3), "alpha": (4, height, width)}
        expected["depth"] = (4, height, width)
        for name, shape in expected.items():
            found = tuple(getattr(self, name).shape)
            if found != shape:
                raise ValueError(f"FourViews.{name}: expected shape {shape}, found {found}")
        if height != width:
            raise ValueError(f"FourViews: expected square images, found {width} x {height}")
        if len(self.cameras) != 4:
            raise ValueError(f"FourViews.cameras: expected 4 cameras, found {len(self.cameras)}")

    @classmethod
    def from_render(cls, render: Render, cameras: Cameras) -> FourViews:
        """Wrap a render that was made over a black background (the renderer's default)."""
        return cls(render.color, render.alpha, render.depth, cameras)


@dataclass(frozen=True, slots=True)
class PriorViews:
    """The framing a prior was trained on, which runs must keep to."""

    fov_deg: float  # vertical field of view
    extent_range: tuple[float, float]  # visible extent at the target, object frame units
    elevation_range_deg: tuple[float, float]
    resolution_px: int  # side of the images the prior works on

    @property
    def mean_extent(self) -> float:
        """Visible extent in the middle of the range, object frame units."""
        return sum(self.extent_range) / 2

    def radius_range(self) -> tuple[float, float]:
        """Return the camera distances that show the least and the largest extent."""
        low, high = self.extent_range
        return radius_to_fit(low, self.fov_deg), radius_to_fit(high, self.fov_deg)


RescaleCenter = Literal["zero", "background"]
"""The value about which guidance rescale reduces contrast. ``zero``: zero in the model's own
images, as published (Lin et al. 2023); it also pulls the background towards zero, and splats
imitate that with fog. ``background``: the colour behind the renders, which then stays as it is."""


@dataclass(frozen=True, slots=True)
class Guidance:
    """How strongly each condition pulls the denoised image away from the unconditional one.

    With denoised images x(input?, text?): ``x(-,-) + input_scale (x(P,-) - x(-,-)) +
    text_scale (x(P,y) - x(P,-))``. A scale of 1 for both is plain conditional denoising, one pass.
    """

    text_scale: float = 1.0
    input_scale: float = 1.0  # unused by priors that cannot see the input, and without input
    rescale: float = 0.0  # 0 to 1: pull the contrast back to the conditional image's
    rescale_about: RescaleCenter = "zero"
    """The value that contrast is measured from. ``background`` applies to priors that see only
    colours (latent diffusion models); priors that see alpha have no background."""


def prior_identity(prior: Prior) -> str | dict[str, Any]:
    """Return everything about a prior that decides a run's result, as JSON values.

    A prior may provide it as an attribute ``identity`` (digest of its weights, its knobs); for
    other priors it is the name.
    """
    identity = getattr(prior, "identity", None)
    return prior.name if identity is None else {"name": prior.name, **to_json(identity)}


class Conditioning(Protocol):
    """A prompt as a prior understood it; opaque but for its report."""

    @property
    def report(self) -> tuple[str, ...]:
        """Lines that tell the user how the prompt was understood."""
        ...


class Prior(Protocol):
    """A model of what objects look like from four sides."""

    @property
    def name(self) -> str:
        """Name for reports, such as ``embedded``."""
        ...

    @property
    def views(self) -> PriorViews:
        """Framing that the prior's input renders must have."""
        ...

    @property
    def sees_input(self) -> bool:
        """Whether ``input_views`` (renders of P) makes a difference."""
        ...

    @property
    def num_timesteps(self) -> int:
        """Length of the noise schedule."""
        ...

    def default_guidance(self, *, sees_input: bool) -> Guidance:
        """Return the scales that are used when none are given, with P in sight or without."""
        ...

    def condition(self, prompt: str, negative_prompt: str | None = None) -> Conditioning:
        """Encode a prompt once for all steps of a run.

        Args:
            prompt: free text; empty means no text.
            negative_prompt: what guidance leads away from, "" = no text; None = the prior's
                default, which is no text for most.
        """
        ...

    def distill(
        self,
        views: FourViews,
        timestep: float,
        conditioning: Conditioning,
        generator: torch.Generator,
        input_views: FourViews | None = None,
        guidance: Guidance | None = None,
    ) -> Tensor:  # []
        """Score distillation loss of the renders (paper, Equation 2; x0-reconstruction form).

        With x the renders at the prior's resolution in the prior's own range and x0 the guided
        denoised image of x noised to ``timestep``, the loss is ``0.5 * sum((x - stop(x0))^2) / 4``:
        summed over pixels and channels, averaged over the four views. Its graph leads to
        ``views``; the denoiser itself is never differentiated.

        Args:
            views: renders of the current splats, with graph.
            timestep: noise level, in [0, num_timesteps).
            conditioning: from :meth:`condition` of the same prior.
            generator: the source of the noise.
            input_views: renders of P by the same cameras; None withholds P (text-only mode).
            guidance: scales; None = the prior's default.
        """
        ...

    def reconstruct(
        self,
        views: FourViews,
        timestep: float,
        conditioning: Conditioning,
        generator: torch.Generator,
        input_views: FourViews | None = None,
        guidance: Guidance | None = None,
        num_steps: int = 8,
    ) -> tuple[Tensor, Tensor]:  # [4, h, w, 3] premultiplied, [4, h, w]
        """Noise the renders to ``timestep`` and denoise them in ``num_steps`` to clean targets.

        Iterative reconstruction in the manner of MicroDreamer. A timestep of
        ``num_timesteps - 1`` or more starts from pure noise, so that ``views`` gives only the
        cameras. The result has the prior's resolution and no graph.
        """
        ...


@dataclass(frozen=True, slots=True)
class FirstGuess:
    """A prior's guess of what is missing."""

    splats: Splats
    """New splats in the object frame, where P has none."""
    notes: tuple[str, ...]
    """How the guess was made, for the user."""


@runtime_checkable
class ShapePrior(Protocol):
    """A prior that can also guess the complete object from P at once."""

    def first_guess(
        self,
        partial: Splats,
        distribution: ViewDistribution,
        conditioning: Conditioning,
        generator: torch.Generator,
        count: int,
        mirror: MirrorWish = "guess",
        *,
        known_shapes: bool = True,
        prompt_decides: bool = False,
        captured: bool = False,
    ) -> FirstGuess | None:
        """Guess what is missing.

        Args:
            partial: P in the object frame.
            distribution: V; space that its views show to be empty stays empty.
            conditioning: from ``condition`` of the same prior.
            generator: chooses where splats sit.
            count: most splats, not counting P's own mirrored ones.
            mirror: the plane to mirror P through, or how it is chosen.
            known_shapes: whether known shapes of the prompt's noun may help.
            prompt_decides: whether the known shape that suits P best is taken as the guess.
            captured: whether P was trained from photos and nothing was cut off it; then its
                outlines are the object's from where the photos were taken.

        Returns:
            None if these weights cannot guess; no splats if nothing seems to be missing.
        """
        ...

    def likely_mirrors(
        self, partial: Splats, distribution: ViewDistribution, conditioning: Conditioning
    ) -> tuple[ChosenMirror, ...]:
        """Return mirrors to choose from: planes that differ, the likeliest first; the cut; "none".

        Args:
            partial: P in the object frame.
            distribution: V.
            conditioning: from ``condition`` of the same prior.

        Returns:
            Nothing at all if these weights cannot guess.
        """
        ...


@runtime_checkable
class KnowsShapes(Protocol):
    """A prior that can be shown a known shape of the prompt's noun in the place of P."""

    def with_known_shape(
        self, conditioning: Conditioning, partial: Splats, distribution: ViewDistribution
    ) -> Conditioning:
        """Return the conditioning with a known shape of its noun.

        Args:
            conditioning: from ``condition`` of the same prior.
            partial: P in the object frame, to which the shape is fitted.
            distribution: V.

        Returns:
            The conditioning as it is where no shape of the noun is known.
        """
        ...
