"""The loop: P frozen, new splats moved by the prior and the preservation loss (paper section 3).

Conventions
-----------
* Everything is in the object frame. ``partial`` (P) is drawn in every render and never changes.
* A step is a function of (state, seed, step number): nothing else is random, so a run that is
  stopped and resumed takes the same steps.
* Views of one step are rendered in one call: the ring of four for the prior, then views of V.
"""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.completion import schedules
from gscomplete.completion.losses import fit_loss, preservation_loss, random_background
from gscomplete.completion.rings import Ring, RingMemory, inside_distribution, random_ring
from gscomplete.completion.settings import CompletionSettings
from gscomplete.completion.start import scale_bounds
from gscomplete.errors import UserError
from gscomplete.fitting.densify import (
    FINAL_OPACITY,
    PRUNE_OPACITY,
    GradientStatistics,
    prune_mask,
    subdivide,
)
from gscomplete.fitting.finite import require_finite
from gscomplete.fitting.parameters import BoundedParameters
from gscomplete.priors.base import Conditioning, FourViews, Guidance, Prior
from gscomplete.render import Render
from gscomplete.render.partial_views import PartialViews
from gscomplete.splats import Splats
from gscomplete.util.device import plain_torch
from gscomplete.util.randomness import generator_for, uniform
from gscomplete.util.stages import stage
from gscomplete.views import Cameras, ViewDistribution

_CORNER_RADIUS = 0.9
"""New splats may be at least this far from the origin, so that they reach the unit cube's
corners."""


@dataclass(frozen=True, slots=True)
class StepReport:
    """What one step did."""

    step: int
    timestep: float
    guidance_loss: float
    preservation_loss: float | None  # None: the loss took no part in this step
    new_splats: int
    seconds: float


@dataclass(frozen=True, slots=True)
class _Pull:
    """The prior's gradient at the pixels of a ring, kept for the steps until its next call."""

    color: Tensor  # [4, H, W, 3] gradient of the prior's loss
    alpha: Tensor  # [4, H, W]
    loss: Tensor  # []

    def on(self, view: Render) -> Tensor:  # []
        """Return a term of the loss's gradient and value."""
        term = (view.color * self.color).sum() + (view.alpha * self.alpha).sum()
        return term - term.detach() + self.loss

    @property
    def tensors(self) -> dict[str, Tensor]:
        """For a checkpoint."""
        return {"pull.color": self.color, "pull.alpha": self.alpha, "pull.loss": self.loss}


class Optimisation:
    """The steps of a completion: the new splats, their optimiser and the current targets."""

    def __init__(
        self,
        partial: Splats,
        start: Splats,
        prior: Prior,
        conditioning: Conditioning,
        views: ViewDistribution,
        settings: CompletionSettings,
        device: torch.device | str = "cpu",
    ) -> None:
        """Set up step 0.

        Args:
            partial: P in the object frame.
            start: the new splats, object frame (``start.start_splats``).
            prior: the model that guides.
            conditioning: the prompt as that prior encoded it.
            views: V, from which P must keep its appearance.
            settings: every knob.
            device: where splats are rendered and moved; the prior may run on another.
        """
        self._device = torch.device(device)
        self.partial = partial.detach().to(self._device)
        self.views = views
        self.settings = settings
        self.step_number = 0
        self._prior, self._conditioning = prior, conditioning
        self._size_px = settings.resolution_px or prior.views.resolution_px
        self._max_radius = max(prior.views.mean_extent / 2, _CORNER_RADIUS)
        bounds = scale_bounds(prior.views, settings)
        self.parameters = BoundedParameters(start.to(self._device), settings.learning_rates, bounds)
        self._statistics = GradientStatistics(len(self.parameters), self._device)
        self._rings = RingMemory(settings.ring_memory)
        self._renders = PartialViews(self.partial)
        self._pull: _Pull | None = None
        self._updating = False

    @property
    def between_updates(self) -> bool:
        """Whether a run may continue from :meth:`state`.

        False after a step that was interrupted (Ctrl-C, an error) while it changed the splats.
        """
        return not self._updating

    @property
    def finished(self) -> bool:
        """Whether all steps are done."""
        return self.step_number >= self.settings.steps

    @property
    def new_splats(self) -> Splats:
        """The current new splats, object frame, without P."""
        return self.parameters.splats().detach()

    @plain_torch()
    def step(self) -> StepReport:
        """Take one optimiser step.

        Raises:
            NonFiniteError: a loss, gradient or parameter is not finite.
            UserError: the prior returned something else than it should.
        """
        started = time.perf_counter()
        settings, step = self.settings, self.step_number
        timestep = schedules.timestep_at(settings, step)
        wants_targets = settings.mode == "reconstruct" and schedules.is_round_start(settings, step)
        if wants_targets and self._rings.newest_step != step:  # else a step begun before made them
            with stage("prior"):
                self._rings.add(self._denoised_ring(timestep))
        ring_cameras, ring = self._guidance_views()
        batches = [ring_cameras]
        preserving = schedules.has_preservation(settings, step)
        if preserving:
            batches.append(self._preservation_view())
        count = sum(len(cameras) for cameras in batches)
        splats = self.parameters.splats()
        if settings.moves == "colors":
            splats = dataclasses.replace(splats.detach(), sh=splats.sh)
        offsets = torch.zeros(count, len(splats), 2, device=self._device, requires_grad=True)
        with stage("render"):
            drawn = self._renders.together(splats, batches, offsets)
        background = random_background(generator_for(settings.seed, step, "background"))
        background = background.to(self._device)
        view = drawn[:4]
        pull = self._held_pull(view)
        if pull is not None:
            guidance = pull.on(view)
        else:
            with stage("prior"):
                guidance = self._guidance_loss(view, ring_cameras, ring, timestep, background)
        total, preservation = guidance, None
        if preserving:
            preservation = preservation_loss(
                drawn[4:],
                self._renders.alone(batches[1]),
                background,
                masked=not schedules.is_warmup(settings, step),
            )
            total = total + settings.preservation_weight * preservation
        asked = settings.prior_every > 1 and settings.mode == "distill" and pull is None
        if asked:
            view.color.retain_grad()
            view.alpha.retain_grad()
        with stage("gradients"):
            total.backward()
        if asked:
            pull = _Pull(_gradient(view.color), _gradient(view.alpha), guidance.detach())
        losses = {"the prior's loss": guidance, "the preservation loss": preservation}
        require_finite(step, **losses, **self.parameters.gradients())
        require_finite(step, **{"gradient of screen positions": offsets.grad})
        self._updating = True
        if offsets.grad is not None:
            self._statistics.add(offsets.grad, ring_cameras.width, ring_cameras.height)
        self.parameters.step(step / settings.steps)
        require_finite(step, **self.parameters.values())
        self._edit_splats(step)
        self._pull = pull
        self.step_number += 1
        self._updating = False
        return StepReport(
            step,
            timestep,
            float(guidance.detach()),
            None if preservation is None else float(preservation.detach()),
            len(self.parameters),
            time.perf_counter() - started,
        )

    def state(self) -> dict[str, Tensor]:
        """Return everything a resumed run needs, as named tensors, which the next step changes."""
        return {
            "step": torch.tensor(self.step_number),
            "statistics.total": self._statistics.total,
            "statistics.views": self._statistics.views,
            **self.parameters.state(),
            **self._rings.tensors,
            **({} if self._pull is None else self._pull.tensors),
        }

    def restore(self, state: dict[str, Tensor]) -> None:
        """Continue from :meth:`state`.

        Raises:
            ValueError: the targets of the rounds are missing, or of other shapes.
        """
        self.step_number = int(state["step"])
        state = {
            name: value if _stays_on_cpu(name) else value.to(self._device)
            for name, value in state.items()
        }
        self.parameters.restore(state)
        self._statistics.total = state["statistics.total"].clone()
        self._statistics.views = state["statistics.views"].clone()
        self._rings.restore(state)
        self._pull = None
        if "pull.loss" in state:
            pulled = (state[f"pull.{name}"] for name in ("color", "alpha", "loss"))
            self._pull = _Pull(*pulled)
        if self.settings.mode == "reconstruct" and self.step_number and not len(self._rings):
            raise ValueError("ring.0.color: expected the targets of a round, found none")

    @property
    def heeds_negative_prompt(self) -> bool:
        """Whether a negative prompt has any effect: steps are taken and guidance uses the text."""
        return self.settings.steps > 0 and self._guidance_scales().text_scale != 1.0

    def _guidance_scales(self) -> Guidance:
        """Return the prior's own guidance, about the centre that the settings ask for."""
        sees = self.settings.see_input and self._prior.sees_input
        own = self._prior.default_guidance(sees_input=sees)
        center = self.settings.rescale_about
        return own if center is None else dataclasses.replace(own, rescale_about=center)

    def _input_views(self, cameras: Cameras) -> FourViews | None:
        """Return P's renders for priors that can see them."""
        if not (self.settings.see_input and self._prior.sees_input):
            return None
        with torch.no_grad():
            return FourViews.from_render(self._renders.alone(cameras), cameras)

    def _denoised_ring(self, timestep: float) -> Ring:
        """Render a fresh ring, let the prior denoise it, and keep P where V sees it."""
        settings, step = self.settings, self.step_number
        cameras = random_ring(self._prior.views, self._size_px, settings.seed, step)
        splats = self.new_splats
        with torch.no_grad():
            drawn = self._renders.together(splats, [cameras])
            color, alpha = self._prior.reconstruct(
                FourViews.from_render(drawn, cameras),
                timestep,
                self._conditioning,
                generator_for(settings.seed, step, "denoise"),
                self._input_views(cameras),
                self._guidance_scales(),
                settings.denoise_steps,
            )
            _require_targets(color, alpha, f"prior {self._prior.name}: reconstruct")
            targets = {
                "colour of the prior's targets": color,
                "alpha of the prior's targets": alpha,
            }
            require_finite(step, **targets)
            target = cameras.resized(color.shape[2], color.shape[1])
            partial = self._renders.alone(target)
            trusted = inside_distribution(target, self.views).to(self._device)
            mask = torch.where(trusted[:, None, None], partial.alpha, 0.0)
            color = color * (1 - mask)[..., None] + partial.color * trusted[:, None, None, None]
            alpha = alpha * (1 - mask) + mask
        return Ring(target, color, alpha, step)

    def _guidance_views(self) -> tuple[Cameras, Ring | None]:
        """Return the ring of this step: a fresh one, or one of those with targets."""
        settings, step = self.settings, self.step_number
        size_px = schedules.resolution_at(settings, step, self._size_px)
        if settings.mode == "distill":
            asked = step - step % settings.prior_every
            return random_ring(self._prior.views, size_px, settings.seed, asked), None
        pick = uniform(generator_for(settings.seed, step, "ring"), 0, len(self._rings))
        ring = self._rings[int(pick)]
        return ring.cameras.resized(size_px, size_px), ring

    def _held_pull(self, view: Render) -> _Pull | None:
        """Return the prior's last gradient for this ring; None = the prior has to be called."""
        pull = self._pull
        if self.step_number % self.settings.prior_every == 0 or pull is None:
            return None
        return pull if pull.alpha.shape == view.alpha.shape else None

    def _preservation_view(self) -> Cameras:
        """Return this step's view of V."""
        settings, step = self.settings, self.step_number
        size_px = schedules.resolution_at(settings, step, self._size_px)
        if settings.preservation_views is None:
            angles = self.views.sample(settings.seed, step, 1)
            return self.views.cameras(angles, size_px)
        generator = generator_for(settings.seed, step, "preservation view")
        pick = int(uniform(generator, 0, settings.preservation_views))
        angles = self.views.low_discrepancy(settings.preservation_views)
        return self.views.cameras(angles, size_px)[pick]

    def _guidance_loss(
        self,
        drawn: Render,
        cameras: Cameras,
        ring: Ring | None,
        timestep: float,
        background: Tensor,  # [3]
    ) -> Tensor:
        """Return the prior's loss (distill) or the distance to its targets (reconstruct)."""
        if ring is not None:
            color, alpha = ring.resized(cameras.width)
            return fit_loss(drawn, color, alpha, background)
        loss = self._prior.distill(
            FourViews.from_render(drawn, cameras),
            timestep,
            self._conditioning,
            generator_for(self.settings.seed, self.step_number, "noise"),
            self._input_views(cameras),
            self._guidance_scales(),
        )
        _require_loss(loss, f"prior {self._prior.name}: distill")
        return loss.to(self._device)

    def _edit_splats(self, step: int) -> None:
        """Subdivide and prune when the schedule says so; statistics start anew."""
        settings = self.settings
        if settings.moves == "colors":
            return
        if schedules.is_densify_step(settings, step):
            subdivide(self.parameters, self._statistics, settings.densify, settings.seed, step)
        if schedules.is_prune_step(settings, step):
            late = step >= settings.densify.final_from * settings.steps
            opacity = FINAL_OPACITY if late else PRUNE_OPACITY
            keep, report = prune_mask(self.new_splats, opacity, self._max_radius)
            if report.total and bool(keep.any()):
                self.parameters.edit(keep)
            self._statistics = GradientStatistics(len(self.parameters), self._device)


def _stays_on_cpu(name: str) -> bool:
    """Whether a tensor of a checkpoint is a camera, or a count that Adam keeps there."""
    return name.endswith(("step", "_px", "camera_from_world"))


def _require_loss(loss: object, what: str) -> None:
    """Refuse a loss that would not move the splats, at the first step rather than silently."""
    if not isinstance(loss, Tensor):
        raise UserError(f"{what}: expected a tensor, found {type(loss).__name__}")
    if loss.numel() != 1:
        raise UserError(f"{what}: expected one number, found shape {tuple(loss.shape)}")
    if not loss.requires_grad:
        raise UserError(f"{what}: expected a loss with gradients to the renders, found none")


def _require_targets(color: Tensor, alpha: Tensor, what: str) -> None:
    """Refuse targets that are not four square pictures."""
    side = alpha.shape[-1] if alpha.ndim else 0
    found = tuple(color.shape), tuple(alpha.shape)
    if found != ((4, side, side, 3), (4, side, side)):
        raise UserError(
            f"{what}: expected colours [4, h, h, 3] and alphas [4, h, h], found shapes "
            f"{list(found[0])} and {list(found[1])}"
        )


def _gradient(value: Tensor) -> Tensor:
    """Return what a value's gradient is, zeros where nothing depends on it."""
    return torch.zeros_like(value) if value.grad is None else value.grad.detach()
