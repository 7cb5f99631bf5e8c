"""Training of splats from posed photos (Kerbl et al. 2023): the loop and its state.

Conventions
-----------
* A step draws one photo's view, compares it with the photo, and moves the splats. It is a function
  of (state, seed, step number): a run that is stopped and resumed takes the same steps.
* Splats live in the world frame of the poses.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gscomplete.fitting.densify import GradientStatistics
from gscomplete.fitting.finite import NonFiniteError
from gscomplete.render import render
from gscomplete.render.settings import RenderSettings
from gscomplete.splats import Splats
from gscomplete.util.randomness import generator_for
from gscomplete.util.same_bits import fixed_mean, fixed_sum
from gscomplete.views import Cameras
from splatcomplete_data.multiview.photos.images import View
from splatcomplete_data.multiview.training.growth import GrowthReport, grow
from splatcomplete_data.multiview.training.parameters import PhotoParameters
from splatcomplete_data.multiview.training.settings import (
    GROWTH_UNTIL_SHARE,
    LONG_STEPS,
    RESET_OPACITY,
    TrainingSettings,
)
from splatcomplete_data.multiview.training.ssim import Reference, ssim_map

CHECK_EVERY = 100
"""Steps between two checks for values that are not finite, besides the one before every save."""
_ARRAYS_PER_REFERENCE = 3
_REFERENCE_BYTES = 2**30
"""Blurs of photos are kept up to this many bytes; beyond it they are made in every step."""
_DIVISIONS_PER_RUN = 18
"""At least this many intervals of division fit into a run, of which the schedule uses about ten:
with the interval of long runs, short ones would hardly divide."""
_FEWEST_STEPS_PER_DIVISION = 10
"""Gradients are averaged over at least this many steps before splats are divided by them."""


@dataclass(frozen=True, slots=True)
class StepReport:
    """What one step did."""

    step: int
    photo: str
    loss: float
    splats: int
    growth: GrowthReport | None  # None: no division in this step
    seconds: float


@dataclass(frozen=True, slots=True)
class Target:
    """One photo at one size, as the loss sees it."""

    name: str
    camera: Cameras
    colors: Tensor  # [H, W, 3] in [0, 1]
    weight: Tensor | None  # [H, W, 1]; None = 1 everywhere
    alpha: Tensor | None  # [H, W, 1]; None = everything is to be reconstructed

    @staticmethod
    def of(view: View, device: torch.device) -> Target:
        """Turn a view into tensors."""

        def unit(values: np.ndarray) -> Tensor:
            return torch.from_numpy(values).to(device).float() / 255.0

        everywhere = bool((view.weight == 255).all())
        return Target(
            view.name,
            view.camera.to(dtype=torch.float32),
            unit(view.colors),
            None if everywhere else unit(view.weight)[:, :, None],
            None if view.alpha is None else unit(view.alpha)[:, :, None],
        )

    def halved(self) -> Target:
        """Return the target at half the size (means of 2 x 2 pixels, odd edges cut off)."""
        height, width = self.camera.height // 2, self.camera.width // 2
        if min(height, width) < 1:
            return self
        camera = self.camera.resized(width, height)
        factor = self.camera.focal_px.new_tensor([0.5, 0.5])
        camera = dataclasses.replace(
            camera,
            focal_px=self.camera.focal_px * factor,
            center_px=self.camera.center_px * factor,
        )
        weight = None if self.weight is None else (_half(self.weight) > 0.999).float()
        alpha = None if self.alpha is None else _half(self.alpha)
        return Target(self.name, camera, _half(self.colors), weight, alpha)


def _half(image: Tensor) -> Tensor:  # [H, W, C] -> [H // 2, W // 2, C]
    """Average blocks of 2 x 2 pixels."""
    height, width = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    blocks = image[:height, :width].reshape(height // 2, 2, width // 2, 2, -1)
    return blocks.mean(dim=(1, 3))


def photo_loss(
    image: Tensor,  # [H, W, 3]
    photo: Tensor,  # [H, W, 3]
    ssim_weight: float,
    reference: Reference | None = None,
) -> Tensor:  # []
    """Return (1 - w) L1 + w (1 - SSIM) (Kerbl et al. 2023, Equation 7).

    Args:
        image: a render.
        photo: what it is compared with.
        ssim_weight: w.
        reference: the photo with its blurs; None = they are computed.
    """
    difference = fixed_mean((image - photo).abs())
    if ssim_weight == 0:
        return difference
    similarity = fixed_mean(ssim_map(image, reference or Reference.of(photo)))
    return (1 - ssim_weight) * difference + ssim_weight * (1 - similarity)


class Training:
    """A training under way."""

    def __init__(
        self,
        views: Sequence[View],
        initial: Splats,
        extent: float,
        settings: TrainingSettings,
        device: torch.device | None = None,
    ) -> None:
        """Set up step 0.

        Args:
            views: the photos to train on.
            initial: splats in the world frame of the views' cameras.
            extent: length that step sizes and thresholds are shares of, world units.
            settings: every knob.
            device: where to compute; None = the CPU.
        """
        self.settings, self.extent = settings, extent
        self.step_number = 0
        self._device = device or torch.device("cpu")
        self._targets = [Target.of(view, self._device) for view in views]
        self._halves = [target.halved() for target in self._targets]
        self._references: dict[int, Reference] = {}
        pixels = sum(t.colors.numel() for t in (*self._targets, *self._halves))
        self._keeps_references = 4 * _ARRAYS_PER_REFERENCE * pixels <= _REFERENCE_BYTES
        start = initial.with_sh_degree(settings.sh_degree).to(self._device)
        self.parameters = PhotoParameters(start, settings.step_sizes, extent)
        self._statistics = GradientStatistics(len(start), self._device)
        self._draw = RenderSettings(near=settings.near_extent * extent)
        self._updating = False

    @property
    def between_updates(self) -> bool:
        """Whether :meth:`state` is one that a training may go on from.

        False after a step that was broken off (Ctrl-C, an error) while it changed the splats.
        """
        return not self._updating

    @property
    def finished(self) -> bool:
        """Whether all steps are taken."""
        return self.step_number >= self.settings.steps

    def splats(self) -> Splats:
        """Return the splats as they are now, detached, on the CPU."""
        return self.parameters.splats().detach().to("cpu")

    def step(self) -> StepReport:
        """Take one step.

        Raises:
            NonFiniteError: a parameter is no longer finite.
        """
        started = time.perf_counter()
        settings, number = self.settings, self.step_number
        target = self._target(number)
        degree = settings.sh_degree
        if settings.sh_share > 0:
            degree = min(degree, int(number / (settings.sh_share * settings.steps)))
        splats = self.parameters.splats(degree)
        growing = number < GROWTH_UNTIL_SHARE * settings.steps
        offsets = None
        if growing:
            offsets = torch.zeros(1, len(splats), 2, device=self._device, requires_grad=True)
        background = self._background(target, number)
        drawn = render(
            splats, target.camera, background, screen_offsets=offsets, settings=self._draw
        )
        image, photo = drawn.color[0], target.colors
        if target.alpha is not None and background is not None:
            photo = photo * target.alpha + background * (1 - target.alpha)
        if target.weight is not None:
            image, photo = image * target.weight, photo * target.weight
        reference = None if background is not None else self._reference(target, photo)
        loss = photo_loss(image, photo, settings.ssim_weight, reference)
        loss.backward()
        self._updating = True
        self.parameters.step(number / settings.steps)
        self.step_number = number + 1
        report = None
        if offsets is not None and offsets.grad is not None:
            camera = target.camera
            self._statistics.add(offsets.grad, camera.width, camera.height)
            report = self._edit()
        self._updating = False
        if self.step_number % CHECK_EVERY == 0 or self.finished:
            bad = self.parameters.first_nonfinite()
            if bad is not None:
                raise NonFiniteError(number, bad)
        return StepReport(
            number,
            target.name,
            float(loss.detach()),
            len(self.parameters),
            report,
            time.perf_counter() - started,
        )

    def _target(self, number: int) -> Target:
        """Return the photo of a step: every photo once per round, in an order of its own."""
        count = len(self._targets)
        round_, place = divmod(number, count)
        order = torch.randperm(count, generator=generator_for(self.settings.seed, round_, "photos"))
        small = number < self.settings.half_size_share * self.settings.steps
        return (self._halves if small else self._targets)[int(order[place])]

    def _reference(self, target: Target, photo: Tensor) -> Reference | None:
        """Return a photo with its blurs, kept where those of all photos take little memory."""
        if not self._keeps_references or self.settings.ssim_weight == 0:
            return None
        if id(target) not in self._references:
            self._references[id(target)] = Reference.of(photo)
        return self._references[id(target)]

    def _background(self, target: Target, number: int) -> Tensor | None:  # [3]
        """Return a random colour where the photo has a mask: only transparency fits all of them."""
        if target.alpha is None:
            return None
        generator = generator_for(self.settings.seed, number, "background")
        return torch.rand(3, generator=generator).to(self._device)

    def _edit(self) -> GrowthReport | None:
        """Divide, prune and lower opacities when it is time to."""
        growth, number, steps = self.settings.growth, self.step_number, self.settings.steps
        report = None
        reset_every = 0
        if growth.reset_share is not None and steps >= LONG_STEPS:
            reset_every = round(growth.reset_share * steps)
        every = min(growth.every, max(_FEWEST_STEPS_PER_DIVISION, steps // _DIVISIONS_PER_RUN))
        if number % every == 0 and number > growth.from_share * steps:
            report = grow(
                self.parameters,
                self._statistics,
                growth,
                extent=self.extent,
                prune_large=bool(reset_every) and number > reset_every,
                seed=self.settings.seed,
                step=number,
            )
            self._statistics = GradientStatistics(len(self.parameters), self._device)
        if reset_every and number % reset_every == 0 and number + reset_every <= steps:
            self.parameters.lower_opacities(RESET_OPACITY)
        return report

    def state(self) -> dict[str, Tensor]:
        """Return all that the next step depends on.

        Raises:
            NonFiniteError: a value is not finite: no checkpoint may hold it.
        """
        state = {
            "step": torch.tensor(self.step_number),
            "gradient.total": self._statistics.total,
            "gradient.seen": self._statistics.views,
            **self.parameters.state(),
        }
        for name, value in state.items():
            if not bool(torch.isfinite(value).all()):
                raise NonFiniteError(self.step_number - 1, name)
        return state

    def restore(self, state: dict[str, Tensor]) -> None:
        """Continue from :meth:`state`."""
        state = {name: value.to(self._device) for name, value in state.items()}
        self.step_number = int(state["step"])
        self.parameters.restore(state)
        self._statistics = GradientStatistics(len(self.parameters), self._device)
        self._statistics.total, self._statistics.views = (
            state["gradient.total"],
            state["gradient.seen"],
        )


def evaluate_views(
    splats: Splats, views: Sequence[View], extent: float, settings: TrainingSettings
) -> list[float]:
    """Return the PSNR in dB of every view over its valid pixels, colours clamped to [0, 1].

    Pixels outside an object mask are compared over black.
    """
    results = []
    draw = RenderSettings(near=settings.near_extent * extent)
    for view in views:
        target = Target.of(view, splats.means.device)
        with torch.no_grad():
            image = render(splats, target.camera, settings=draw).color[0].clamp(0, 1)
        photo = target.colors if target.alpha is None else target.colors * target.alpha
        squared = (image - photo).square().mean(dim=2, keepdim=True).double()
        weight = torch.ones_like(squared) if target.weight is None else target.weight.double()
        mean = float(fixed_sum(squared * weight) / fixed_sum(weight).clamp_min(1))
        results.append(-10.0 * float(np.log10(max(mean, 1e-10))))
    return results
