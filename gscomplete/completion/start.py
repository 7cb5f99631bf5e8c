"""The new splats at the first step: the prior's guess, what closes P's gaps, or a sphere (3.3).

Conventions
-----------
* Everything is in the object frame.
* A function of (P, V, prompt, settings): a resumed run starts from the same splats.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import torch

from gscomplete.completion.settings import CompletionSettings
from gscomplete.errors import UserError
from gscomplete.fitting.finite import require_finite
from gscomplete.fitting.parameters import Bounds
from gscomplete.priors.base import Conditioning, FirstGuess, Prior, PriorViews, ShapePrior
from gscomplete.shape.colors.edges import without_mixed_edges
from gscomplete.shape.mirror_plane import HalfCut, MirrorWish
from gscomplete.splats import Splats, colors_to_sh
from gscomplete.util.randomness import generator_for, sphere_points
from gscomplete.views import ViewDistribution

INITIAL_OPACITY = 0.1
"""As in the original 3DGS."""


@dataclass(frozen=True, slots=True)
class Start:
    """Where the optimisation starts."""

    splats: Splats
    """New splats."""
    is_guess: bool
    """Whether the prior guessed them; False = scattered in a sphere, or they close gaps."""
    note: str
    """How they came about, for the user."""


def start_splats(
    partial: Splats,
    prior: Prior,
    conditioning: Conditioning,
    views: ViewDistribution,
    settings: CompletionSettings,
    sphere_diameter: float = 1.0,
) -> Start:
    """Return the new splats of step 0.

    Args:
        partial: P in the object frame, on the CPU.
        prior: the model that guides.
        conditioning: the prompt as that prior encoded it.
        views: V, from which P must keep its appearance.
        settings: of the run.
        sphere_diameter: object sizes; the paper takes the largest side of P's box.

    Raises:
        UserError: there are no steps to take and no guess that could be the result.
        NonFiniteError: a value of the start is not finite.
    """
    bounds = scale_bounds(prior.views, settings)
    start = None
    if settings.start == "fill":
        from gscomplete.shape.fill.close import close_gaps  # it loads much of SciPy
        from gscomplete.shape.fill.gaps import FillSettings

        generator = generator_for(settings.seed, 0, "fill")
        filled = close_gaps(partial, generator, FillSettings(settings.new_splats))
        start = Start(filled.splats, False, filled.note)
    elif settings.start == "guess" and isinstance(prior, ShapePrior):
        start = _guess(partial, prior, conditioning, views, settings)
    if start is None and settings.start == "guess" and not settings.steps:
        raise UserError(
            "0 steps: expected a prior that guesses the complete object, found one that cannot; "
            "choose another --preset (such as distill) or give --steps"
        )
    if start is None:
        scattered = initial_splats(
            partial,
            settings.new_splats,
            sphere_diameter,
            settings.seed,
            min_scale=bounds.min_scale,
            max_scale=bounds.max_scale,
        )
        start = Start(scattered, False, f"start: {len(scattered):,} splats in a sphere")
    require_finite(0, **{f"{name} at the start": value for name, value in start.splats.fields()})
    return dataclasses.replace(start, splats=bounds.clamped(start.splats))


def colored_for_guess(partial: Splats, settings: CompletionSettings) -> tuple[Splats, int]:
    """Return P as guesses see it, and how many of its splats have other colours there."""
    return without_mixed_edges(partial) if settings.mixed_edge_colors else (partial, 0)


def guess_by(
    seen: Splats,
    prior: ShapePrior,
    conditioning: Conditioning,
    views: ViewDistribution,
    settings: CompletionSettings,
    mirror: MirrorWish,
) -> FirstGuess | None:
    """Ask for the guess by one plane, or by another way to choose it.

    Args:
        seen: P, from ``colored_for_guess``.
        prior: the model that guesses.
        conditioning: the prompt as that prior encoded it.
        views: V.
        settings: of the run, whose own plane does not matter.
        mirror: what P is mirrored through.
    """
    return prior.first_guess(
        seen,
        views,
        conditioning,
        generator_for(settings.seed, 0, "first guess"),
        settings.new_splats,
        mirror,
        known_shapes=settings.known_shapes,
        prompt_decides=settings.prompt_decides,
        captured=settings.captured,
    )


def _guess(
    partial: Splats,
    prior: ShapePrior,
    conditioning: Conditioning,
    views: ViewDistribution,
    settings: CompletionSettings,
) -> Start | None:
    """Return the prior's guess, which is empty where it finds nothing missing; None = no guess."""
    seen, recolored = colored_for_guess(partial, settings)
    guess = guess_by(seen, prior, conditioning, views, settings, settings.mirror)
    if guess is None:
        return None
    notes = [f"start: {len(guess.splats):,} splats that the prior guesses", *guess.notes]
    if settings.captured and not isinstance(settings.mirror, HalfCut):
        notes.append(
            "P is a capture that was not cut, as it seems: the guess keeps to P's outlines from "
            "where they seem to be the object's (--captured no if the object was cut through)"
        )
    if recolored:
        notes.append(
            f"{recolored:,} splats at P's edges are unlike those further inside: their colours are "
            "not used for the guess (--edge-colors trust uses them)"
        )
    return Start(guess.splats, True, "; ".join(notes))


def scale_bounds(views: PriorViews, settings: CompletionSettings) -> Bounds:
    """Return the bounds of new splats' scales: the smallest is given in pixels of the prior."""
    size_px = settings.resolution_px or views.resolution_px
    return Bounds(settings.min_scale_px * views.mean_extent / size_px, settings.max_scale)


def initial_splats(
    partial: Splats,
    count: int,
    diameter: float,
    seed: int,
    *,
    min_scale: float,
    max_scale: float,
) -> Splats:
    """Scatter new splats uniformly in the sphere about the object-frame origin.

    That is the centre of the complete object as it was guessed or given; the paper's sphere is
    about the centre of P's box, from which what is missing may lie far off.

    Their scale is the mean spacing of ``count`` points in the sphere, their colour that of a random
    splat of P with noise, so that the start is neither dust nor a foreign colour.

    Args:
        partial: P in the object frame; only its colours are used.
        count: number of new splats.
        diameter: of the sphere; the paper takes the largest side of P's box.
        seed: of the run.
        min_scale: lower bound of the scales.
        max_scale: upper bound of the scales.
    """
    generator = generator_for(seed, 0, "initial splats")
    means = torch.from_numpy(sphere_points(count, generator)).float() * (0.5 * diameter)
    spacing = diameter * (torch.pi / 6 / count) ** (1 / 3)
    scale = min(max(0.5 * spacing, min_scale), max_scale)
    pick = torch.randint(len(partial), (count,), generator=generator)
    colors = partial.base_colors[pick].clamp(0.0, 1.0)
    colors = (colors + 0.1 * torch.randn(count, 3, generator=generator)).clamp(0.02, 0.98)
    quaternions = torch.randn(count, 4, generator=generator)
    quaternions /= quaternions.norm(dim=1, keepdim=True)
    return Splats(
        means,
        quaternions,
        torch.full((count, 3), scale),
        torch.full((count,), INITIAL_OPACITY),
        colors_to_sh(colors),
    )
