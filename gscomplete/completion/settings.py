"""Every knob of a completion. Defaults are the paper's; ``presets`` has other choices.

Conventions
-----------
* Lengths are in the object frame (largest side of the object = 1), angles in degrees.
* A stage of a schedule ends at a fraction of all steps, so that one schedule fits any step count.
* Timesteps are those of the prior (0 = clean, 1000 steps); the paper's T is 980.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal

from gscomplete.errors import UserError
from gscomplete.fitting.settings import DensifySettings, LearningRates
from gscomplete.priors.base import RescaleCenter
from gscomplete.shape.mirror_plane import MirrorWish

Mode = Literal["distill", "reconstruct"]
"""``distill``: score distillation, one denoising per step (paper, Equation 2).
``reconstruct``: denoise a ring of views for several steps, then fit the splats to it for many
cheap steps (after MicroDreamer); the preservation loss is the same."""

Start = Literal["sphere", "guess", "fill"]
"""``sphere``: new splats uniform in a sphere (paper, section 3.3). ``guess``: on the surface that a
prior with a shape network guesses (``priors.base.ShapePrior``), else in the sphere. ``fill``: in
the gaps of P, which is complete but for them (``shape.fill``)."""


Moves = Literal["splats", "colors"]
"""``splats``: new splats move, grow, fade, are subdivided and pruned (the paper). ``colors``: their
colours alone change, and the shape stays as it starts."""

LAST_TIMESTEP = 999.0
"""Pure noise."""


@dataclass(frozen=True, slots=True)
class TimestepStage:
    """Timesteps are uniform in [low, high] until ``until`` of all steps."""

    until: float
    low: float
    high: float

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            UserError: a value is outside its range.
        """
        if not 0 < self.until <= 1:
            raise UserError(f"timesteps: expected an end above 0, at most 1, found {self.until}")
        if not 0 <= self.low <= self.high <= LAST_TIMESTEP:
            raise UserError(
                f"timesteps: expected 0 <= low <= high <= {LAST_TIMESTEP:g}, found {self.low} to "
                f"{self.high}"
            )


_ANNEALED_STAGES = 20


def annealed_timesteps(first: float, last: float, width: float) -> tuple[TimestepStage, ...]:
    """Return stages whose middle falls evenly from the first to the last.

    Args:
        first: middle of the first stage.
        last: middle of the last stage.
        width: half of what each stage spans.
    """
    found = []
    for k in range(_ANNEALED_STAGES):
        middle = first + (last - first) * k / (_ANNEALED_STAGES - 1)
        low, high = max(middle - width, 0.0), min(middle + width, LAST_TIMESTEP)
        found.append(TimestepStage((k + 1) / _ANNEALED_STAGES, low, high))
    return tuple(found)


@dataclass(frozen=True, slots=True)
class HardPreservationSettings:
    """Bounds on what new splats may change of P's appearance from V, and how they are reached."""

    color_bound: float = 1e-3
    """Largest E_color over V (``evaluate.metrics``)."""
    depth_bound: float = 5e-4
    """Largest E_depth over V, in squared object sizes."""
    mask_from: float = 0.0
    """Least alpha of P at which a pixel is held to P's appearance; 0 = all pixels, each weighted by
    its alpha, as the errors are defined. Where P consists of a few scattered splats, one mostly
    sees what lies behind, and a completion that fills the gaps has to change that."""
    rounds: int = 10
    """Most rounds of refitting; what is left then is faded out."""
    steps: int = 12
    """Optimiser steps of one round."""

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            UserError: a value is outside its range.
        """
        for name in ("color_bound", "depth_bound"):
            if not 0 < getattr(self, name) < float("inf"):
                raise UserError(f"{name}: expected a positive number, found {getattr(self, name)}")
        if not 0 <= self.mask_from < 1:
            raise UserError(f"mask_from: expected 0 to less than 1, found {self.mask_from}")
        for name, least in (("steps", 1), ("rounds", 0)):
            if getattr(self, name) < least:
                raise UserError(f"{name}: expected at least {least}, found {getattr(self, name)}")


@dataclass(frozen=True, slots=True)
class CompletionSettings:
    """How to complete an object. Defaults are the paper's."""

    mode: Mode = "distill"
    steps: int = 6000
    """Optimiser steps; 0 = new splats stay as they start."""
    least_color_spread: float = 0.0
    """Steps are taken only if the mean distance of P's colours from their mean is at least this
    (``splats.oklab.color_spread``); 0 = always. A small denoiser continues patterns, but shifts an
    even colour."""
    moves: Moves = "splats"
    """What steps change."""
    seed: int = 0
    new_splats: int = 5000
    """New splats at the start, uniform in the sphere about the object (section 3.3). With
    ``start="guess"`` it is their largest number, not counting P's own mirrored splats."""
    start: Start = "sphere"
    """Where new splats start."""
    mirror: MirrorWish = "guess"
    """``start="guess"``: the plane of symmetry that P is mirrored through."""
    known_shapes: bool = True
    """``start="guess"``: whether known shapes of the prompt's noun that suit P help the guess."""
    prompt_decides: bool = False
    """``start="guess"``: whether the known shape of the prompt's noun that suits P best is the
    guess, even if P passes for complete. If P has no colour, it gets the one that the prompt
    names."""
    warmup_steps: int = 50
    """Steps at the start whose preservation loss is unmasked (n_init, section 3.3)."""
    preservation_weight: float = 2.0
    """lambda of section 3.3; 0 = no preservation loss. That loss is a sum over the render's pixels,
    while the prior's is a sum at the prior's own resolution. So renders of half the side give P a
    quarter of the weight."""
    preservation_every: int = 2
    """The preservation loss joins every k-th step (after the warm-up); 1 = always."""
    preservation_views: int | None = None
    """Number of evenly spread views of V that the preservation loss chooses from, for each of which
    P is drawn only once; None = a new random view every time (the paper)."""
    prior_every: int = 1
    """``distill``: the prior is called at every k-th step. The steps until its next call render the
    same ring again and reuse the gradient at its pixels. 1 = at every step (the paper)."""
    timesteps: tuple[TimestepStage, ...] = (
        TimestepStage(0.5, 392.0, 588.0),
        TimestepStage(0.75, 20.0, 343.0),
        TimestepStage(1.0, 20.0, 245.0),
    )
    """Schedule of the diffusion time (section 3.3, with T = 980)."""
    rescale_about: RescaleCenter | None = None
    """The value that guidance rescale measures contrast from; None = the prior's own default."""
    see_input: bool = True
    """Show the renders of P to priors that can see them; False = text only."""
    resolution_px: int | None = None
    """Side of the renders; None = the prior's resolution."""
    coarse_until: float = 0.0
    """Fraction of all steps rendered at half the resolution; 0 = none (the paper)."""
    rounds: int = 12
    """``reconstruct``: how many times targets are made."""
    denoise_steps: int = 10
    """``reconstruct``: denoising steps per round."""
    ring_memory: int = 3
    """``reconstruct``: rings of targets that the fit draws from, the newest included."""
    learning_rates: LearningRates = dataclasses.field(default_factory=LearningRates)
    densify: DensifySettings = dataclasses.field(default_factory=DensifySettings)
    hard_preservation: HardPreservationSettings | None = None
    """Bounds on E_color and E_depth over V that hold at the end; None = whatever the preservation
    loss leaves (the paper)."""
    match_seam_colors: bool = False
    """Match new splats' colours to P's at the seam, at the end; the paper leaves them."""
    mixed_edge_colors: bool = False
    """Colours at P's edges are mixed with the background's, as depth cameras mix them: guesses use
    those further inside instead (``shape.colors.edges``)."""
    captured: bool = False
    """P was trained from photos and nothing was cut off it, so from where they were taken its
    outlines are the object's: guesses keep to those (``shape.outline.scorer``)."""
    leave_out_strays: bool = False
    """Guess nothing from P's strays, splats that float beside its surface, and from a table that it
    stands on (``splats.working_set``); they keep their appearance as all of P does. The paper has
    no guess."""
    close_slits: bool = False
    """Close the slits between a scan's samples, at the end; the paper leaves them."""
    min_scale_px: float = 0.0
    """Smallest scale of a new splat in pixels of the run's resolution (at the centre); splats
    smaller than a pixel's footprint turn to dust at any other resolution. 0 = no bound."""
    max_scale: float = 0.4
    """Largest scale of a new splat."""
    checkpoint_every: int = 500
    """Steps between checkpoints; 0 = only at the end."""

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            UserError: a value is outside its range.
        """
        least = {
            "steps": 0,
            "new_splats": 1,
            "warmup_steps": 0,
            "least_color_spread": 0,
            "preservation_weight": 0,
            "preservation_every": 1,
            "prior_every": 1,
            "rounds": 1,
            "denoise_steps": 1,
            "ring_memory": 1,
            "min_scale_px": 0,
            "checkpoint_every": 0,
        }
        for name, low in least.items():
            if not low <= getattr(self, name) < math.inf:
                raise UserError(f"{name}: expected at least {low}, found {getattr(self, name)}")
        if not 0 < self.max_scale < math.inf:
            raise UserError(f"max_scale: expected a positive length, found {self.max_scale}")
        if self.preservation_views is not None and self.preservation_views < 1:
            raise UserError(
                f"preservation_views: expected at least 1, found {self.preservation_views}"
            )
        if not 0 <= self.coarse_until <= 1:
            raise UserError(f"coarse_until: expected 0 to 1, found {self.coarse_until}")
        if self.resolution_px is not None and not 8 <= self.resolution_px <= 4096:
            raise UserError(f"resolution_px: expected 8 to 4096, found {self.resolution_px}")
        ends = [stage.until for stage in self.timesteps]
        if ends != sorted(set(ends)) or ends[-1:] != [1.0]:
            raise UserError(
                "timesteps: expected stages that end later and later, the last at 1.0, found "
                f"{ends}"
            )

    def ablated(self) -> CompletionSettings:
        """Return the settings without preservation loss, schedule and warm-up (Table 2, row 1).

        Timesteps are then uniform in [20, 980] throughout, as the paper adapts from DreamGaussian.
        """
        return dataclasses.replace(
            self,
            preservation_weight=0.0,
            warmup_steps=0,
            timesteps=(TimestepStage(1.0, 20.0, 980.0),),
        )
