"""Bring the error that new splats cause in P's pictures from V below a bound that the user gives.

The preservation loss of the paper (section 3.2) weighs P's appearance against the prior, so some
error remains. Here, after the optimisation, the errors E_color and E_depth of ``evaluate.metrics``
are brought below bounds while everything else changes as little as possible:

1. Measure the errors over a few check views. If they are far below the bounds, nothing is changed.
   Otherwise measure over all check views. If they are below the bounds, nothing is changed.
2. Back: where P is thin (at its silhouette, in gaps between its splats), colour and depth of what
   lies far behind show through. Copies of P's own splats just behind its surface close it, so that
   the splats far behind need not fade.
3. Refit, a few rounds (``preserve.fit``): the gradient of the errors with respect to opacities
   tells how much each splat contributes. The splats that make up nearly all of the errors may fade,
   move (the depth error pulls a splat in front of P's surface back behind it) and shrink, against a
   term that keeps the pictures from outside V, and beside P within V, as they were. If the last
   round went farther than necessary, part of it is undone. Rounds stop early if they are not going
   to come near the bounds.
4. Fade, while a bound is exceeded: the splats that contribute most lose most of their opacity, as
   many of them as the excess requires.
5. Remove, as the last resort and repeatedly, the splats that the errors depend on most. This ends,
   because P alone has no errors.

Conventions
-----------
* Object frame. P is read only. Splats that contribute nothing (behind P, or beside its mask in all
  of V) are returned bit for bit.
* Nothing is fitted to the check views: they and the views of each round are different members of
  V's low-discrepancy sequence.
* The aim for the errors over the check views is ``MARGIN`` times the bounds, so that views in
  between are within the bounds as well.
* The result is a function of (splats, P, V, settings, seed).
"""

from __future__ import annotations

import dataclasses
import functools
import math
import time
from collections.abc import Collection
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.completion.preserve.fit import (
    MARGIN,
    RoundProblem,
    are_promising,
    fit_round,
    masked_errors,
    outside_cameras,
    relative_error,
)
from gscomplete.completion.preserve.outcome import (
    CheckedErrors,
    HardPreservationReport,
    count_changes,
)
from gscomplete.completion.preserve.shares import enough_of, largest_share
from gscomplete.completion.settings import HardPreservationSettings
from gscomplete.evaluate.metrics import MID_GREY
from gscomplete.render import PreparedFrozen, Render, join_prepared, prepare_frozen, render
from gscomplete.splats import Splats, concatenate
from gscomplete.splats.thinning import thinned
from gscomplete.util.randomness import generator_for
from gscomplete.views import Cameras, ViewDistribution, join_cameras

_CHECK_VIEWS = 24
"""Views of V that the errors are measured over; nothing is fitted to them."""
_FIRST_VIEWS = 8
"""How many of them are measured first."""
_FAR_BELOW = 0.25
"""Errors over these up to this share of the aim are far below the bounds."""
_CHECK_PX = 256
"""Side of the check views. It is that of the evaluation, because errors grow with the
resolution."""
_FIRST_CHECK_VIEW = 10_000
"""Index in V's sequence of the first check view; rounds use the indices from 1 on."""
_FIT_VIEWS = 10
"""Views of V in one round."""
_FIT_PX = 128
"""Side of the pictures that splats are fitted to."""
_MAX_BACKING = 30_000
"""Most copies of P's splats that are tried behind its thin places."""
_GOING_BACK = 3
"""Most attempts to undo part of the last round."""
_PRUNE_OPACITY = 0.01
"""Splats faded below this opacity are removed."""
_WATCHED_SHARE = 0.5
"""Refitting includes errors above this share of the aim, so that they do not rise beyond it."""
_FAINT = 0.05
"""Opacity of the trial copies that show where backing reduces the errors."""
_CLOSE_SHARE = 0.85
"""If the errors are above this share of the aim, no part of the last round is undone."""
_WANTED_SHARE = 0.93
"""Share of the aim that undoing tries to reach: between the above and 1."""
_FADE = 0.5
"""Fading multiplies an opacity by this."""
_FADED_SHARE = 0.8
"""At most the splats that make up this share of all contributions are faded at once."""
_CLEARED_SHARE = 0.9
"""As the last resort, the splats that make up this share of all contributions are removed at
once."""
_FADE_SWEEPS = 24
"""Most fadings before the last resort."""
_BACKING_DISTANCE = 0.01
"""How far behind P's surface the copies are, in object sizes."""
_ACTIVE_SHARE = 0.99
"""The splats that make up this share of the errors take part in a round."""


@dataclass(frozen=True, slots=True)
class HardPreservation:
    """The new splats after the bound was enforced."""

    splats: Splats
    """The rows of ``kept``, then those that were added."""
    kept: Tensor  # [N] bool: which of the rows that were given are left
    report: HardPreservationReport


def preserve_hard(
    new: Splats,
    partial: Splats,
    distribution: ViewDistribution,
    settings: HardPreservationSettings,
    seed: int = 0,
) -> HardPreservation:
    """Change or remove new splats until the errors of P's appearance from V are within the bounds.

    Args:
        new: N new splats in the object frame.
        partial: P in the object frame; it is not changed.
        distribution: V.
        settings: bounds and knobs.
        seed: of the run; decides which views a step of refitting is fitted to.
    """
    started = time.perf_counter()
    original = new.detach()
    work = _Work(original, partial.detach(), distribution, settings, seed)
    found = work.check(original, few=True)
    if work.above(found, _FAR_BELOW):
        found = work.check(original)
    start, before = original, found
    if work.above(found):
        start, found = work.backed(original, found)
    current, rounds, fadings = start, 0, 0
    largest: list[float] = []
    while work.above(found) and rounds < settings.rounds:
        largest.append(max(work.above(found).values()))
        if not are_promising(largest, settings.rounds):
            break
        previous, too_large = current, found
        current = work.refit(current, found, rounds)
        found, rounds = work.check(current), rounds + 1
        if not work.above(found):
            current, found = work.no_further_than_needed(previous, too_large, current, found)
    cleared = torch.zeros(len(start), dtype=torch.bool, device=new.means.device)
    while work.above(found):
        previous, too_large, last_resort = current, found, fadings >= _FADE_SWEEPS
        current, chosen = work.fade(current, found, rounds, fadings, entirely=last_resort)
        if last_resort and not bool(chosen.any()):
            break
        cleared |= chosen & last_resort
        found, fadings = work.check(current), fadings + 1
        if not (last_resort or work.above(found)):
            current, found = work.no_further_than_needed(previous, too_large, current, found)
    kept = (current.opacities == start.opacities) | (current.opacities >= _PRUNE_OPACITY)
    left, count = current.select(kept), len(original)
    if bool((current.opacities[~kept] > 0).any()):
        found = work.check(left)
    return HardPreservation(
        left,
        kept[:count],
        HardPreservationReport(
            before=before,
            after=found,
            met=found.color <= settings.color_bound and found.depth <= settings.depth_bound,
            rounds=rounds,
            fadings=fadings,
            seconds=time.perf_counter() - started,
            mask_from=settings.mask_from,
            added=int(kept[count:].sum()),
            **count_changes(
                original, current.select(torch.arange(count)), kept[:count], cleared[:count]
            ),
        ),
    )


def are_within_bounds(
    new: Splats,
    partial: Splats,
    distribution: ViewDistribution,
    settings: HardPreservationSettings,
    seed: int,
) -> bool:
    """Say whether new splats keep the bounds as they are, by the first check views."""
    work = _Work(new, partial, distribution, settings, seed)
    return not work.above(work.check(new, few=True))


class _Work:
    """P, its views and the knobs, which stay the same while the splats change."""

    def __init__(
        self,
        original: Splats,
        partial: Splats,
        distribution: ViewDistribution,
        settings: HardPreservationSettings,
        seed: int,
    ) -> None:
        """Place the views, and draw P from the first check views."""
        self._partial, self._distribution = partial, distribution
        self._settings, self._seed, self._original = settings, seed, original
        self._background = partial.means.new_tensor(MID_GREY)
        first = self._views(_FIRST_CHECK_VIEW, _FIRST_VIEWS, _CHECK_PX)
        self._first_check = prepare_frozen(partial, first)
        self._outside = outside_cameras(distribution, _FIT_PX)

    @functools.cached_property
    def _check(self) -> PreparedFrozen:
        """P from all check views."""
        rest = self._views(_FIRST_CHECK_VIEW + _FIRST_VIEWS, _CHECK_VIEWS - _FIRST_VIEWS, _CHECK_PX)
        return join_prepared([self._first_check, prepare_frozen(self._partial, rest)])

    @torch.no_grad()
    def check(self, splats: Splats, *, few: bool = False) -> CheckedErrors:
        """Measure the errors over the check views, or over the first of them."""
        prepared = self._first_check if few else self._check
        visible = splats.select(splats.opacities > 0)
        drawn = render(visible, prepared.cameras, self._background, frozen=prepared)
        target = prepared.picture(self._background)
        color, depth = masked_errors(drawn, target, self._settings.mask_from)
        return CheckedErrors(float(color), float(depth), len(prepared))

    def above(self, found: CheckedErrors, share: float = 1.0) -> dict[str, float]:
        """Return the errors above a share of their aims, each in units of its aim."""
        settings = self._settings
        relative = {
            "color": found.color / (MARGIN * settings.color_bound),
            "depth": found.depth / (MARGIN * settings.depth_bound),
        }
        return {name: value for name, value in relative.items() if value > share}

    def backed(self, splats: Splats, found: CheckedErrors) -> tuple[Splats, CheckedErrors]:
        """Back P's thin places with copies of its own splats, if that makes the errors smaller."""
        generator = generator_for(self._seed, 0, "backing")
        copies = thinned(self._partial, _MAX_BACKING, generator)
        camera = self._distribution.input_camera(_CHECK_PX)
        away = camera.camera_from_world[0, 2, :3].to(copies.means)
        copies = dataclasses.replace(
            copies.with_sh_degree(splats.sh_degree),
            means=copies.means + _BACKING_DISTANCE * away,
        )
        faint = dataclasses.replace(copies, opacities=torch.full_like(copies.opacities, _FAINT))
        prepared = prepare_frozen(self._partial, self._round_views(0, _FIT_PX))
        watched = tuple(self.above(found))
        gain = -self._contributions(concatenate([splats, faint]), prepared, watched)[len(splats) :]
        helpful = largest_share(gain.clamp_min(0.0), _ACTIVE_SHARE)
        joined = concatenate([splats, copies.select(helpful)])
        errors = self.check(joined)
        better = sum(self.above(errors, 0.0).values()) < sum(self.above(found, 0.0).values())
        return (joined, errors) if better else (splats, found)

    def refit(self, splats: Splats, found: CheckedErrors, round_: int) -> Splats:
        """Let the splats that contribute fade, move and shrink for some steps."""
        settings = self._settings
        cameras = self._round_views(round_, _FIT_PX)
        prepared = prepare_frozen(self._partial, cameras)
        watched = tuple(self.above(found, _WATCHED_SHARE))
        contributions = self._contributions(splats, prepared, watched)
        active = largest_share(contributions.abs(), _ACTIVE_SHARE)
        if not bool(active.any()):
            return splats
        everything = cameras if self._outside is None else join_cameras([cameras, self._outside])
        backdrop = concatenate([self._partial, splats.select(~active)])
        problem = RoundProblem(
            frozen=prepare_frozen(backdrop, everything),
            before=self._as_it_was(everything),
            target=prepared.picture(self._background),
            background=self._background,
            watched=watched,
        )
        generator = generator_for(self._seed, round_, "hard preservation")
        fitted = fit_round(splats.select(active), problem, settings, 2.0**round_, generator)
        return _replaced(splats, active, fitted)

    def no_further_than_needed(
        self,
        before: Splats,
        before_errors: CheckedErrors,
        after: Splats,
        after_errors: CheckedErrors,
    ) -> tuple[Splats, CheckedErrors]:
        """Undo part of the last round: move splats within the bounds back towards those before it.

        The errors of those before it are too large. The square roots of the errors are assumed to
        change linearly in between.
        """
        low, high = 0.0, 1.0
        best = after
        for _ in range(_GOING_BACK):
            if self.above(after_errors, _CLOSE_SHARE):
                break
            middle = low + (high - low) * self._share_of_way(before_errors, after_errors)
            blend = _blended(before, after, middle)
            errors = self.check(blend)
            if self.above(errors):
                low, before_errors = middle, errors
            else:
                high, best, after_errors = middle, blend, errors
        return best, after_errors

    def _share_of_way(self, too_large: CheckedErrors, found: CheckedErrors) -> float:  # in (0, 1)
        """Return the share of the way from the too large errors at which the wanted ones lie."""
        share = 0.1
        for name, value in self.above(too_large).items():
            start, end = math.sqrt(value), math.sqrt(self.above(found, -1.0)[name])
            share = max(share, (start - math.sqrt(_WANTED_SHARE)) / (start - end))
        return min(share, 0.9)

    def fade(
        self, splats: Splats, found: CheckedErrors, rounds: int, sweep: int, *, entirely: bool
    ) -> tuple[Splats, Tensor]:  # [N] bool: faded
        """Fade the largest contributors, as many as the excess requires; or clear them entirely."""
        prepared = self._check
        if not entirely:
            views = self._round_views(rounds + sweep, _CHECK_PX)
            prepared = prepare_frozen(self._partial, views)
        too_large = self.above(found)
        contributions = self._contributions(splats, prepared, too_large)
        if entirely:
            chosen = largest_share(contributions.abs(), _CLEARED_SHARE)
        else:
            excess = sum(value - 1.0 for value in too_large.values())
            # First-order estimates may fall short, so every sweep fades twice as much as the last.
            chosen = enough_of(contributions, 2.0**sweep * excess / (1.0 - _FADE))
            chosen &= largest_share(contributions.clamp_min(0.0), _FADED_SHARE)
        share = torch.where(chosen, 0.0 if entirely else _FADE, 1.0)
        opacities = splats.opacities * share
        opacities = torch.where(chosen & (opacities < _PRUNE_OPACITY), 0.0, opacities)
        return dataclasses.replace(splats, opacities=opacities), chosen

    def _views(self, first: int, count: int, size_px: int) -> Cameras:
        """Return ``count`` members of V's sequence from the one at ``first`` on."""
        return self._distribution.cameras(self._distribution.low_discrepancy(count, first), size_px)

    def _round_views(self, round_: int, size_px: int) -> Cameras:
        """Return the views of one round, which no other round has."""
        return self._views(1 + round_ * _FIT_VIEWS, _FIT_VIEWS, size_px)

    @torch.no_grad()
    def _as_it_was(self, cameras: Cameras) -> Render:
        """Draw the completion before anything was changed, over black."""
        return render(self._original, cameras, frozen=self._partial)

    def _contributions(
        self, splats: Splats, prepared: PreparedFrozen, watched: Collection[str]
    ) -> Tensor:  # [N]
        """Return how much of the watched errors each splat causes, to first order."""
        # A pixel at the renderer's largest alpha passes no gradient, so opacities stay below it.
        opacities = splats.opacities.clamp_max(0.99).requires_grad_()
        drawn = render(
            dataclasses.replace(splats, opacities=opacities),
            prepared.cameras,
            self._background,
            frozen=prepared,
        )
        error = relative_error(drawn, prepared.picture(self._background), watched, self._settings)
        (gradient,) = torch.autograd.grad(error, opacities)
        return gradient * opacities.detach()


def _blended(first: Splats, second: Splats, share: float) -> Splats:
    """Return splats part of the way from the first to the second; equal rows stay as they are."""
    return dataclasses.replace(
        second,
        means=torch.lerp(first.means, second.means, share),
        scales=torch.lerp(first.scales, second.scales, share),
        opacities=torch.lerp(first.opacities, second.opacities, share),
    )


def _replaced(splats: Splats, rows: Tensor, values: Splats) -> Splats:  # rows: [N] bool
    """Return the splats with new values in some rows."""
    out = {name: value.clone() for name, value in splats.fields()}
    for name, value in values.fields():
        out[name][rows] = value
    return Splats(**out)
