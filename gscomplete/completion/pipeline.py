"""Complete an object in memory: read, frame, start, refine the view, steps, seam, preservation.

:func:`complete` does all of it. Callers that need the stages apart (run folders with checkpoints,
many objects with one prior) use :func:`prepare` up to the first step, ``Prepared.steps`` for the
steps, and :func:`finish` for what follows the last one.

Conventions
-----------
* P comes in the file frame and is never rewritten; ``partial``, ``new`` and V are in the object
  frame, and :attr:`Completed.new_in_file` is what was added in the file frame.
* A result is a function of (P, request, prior): the device, the threads and PyTorch's settings
  (default type and device, gradients, autocast) do not matter.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

import gscomplete
from gscomplete.completion.optimise import Optimisation, StepReport
from gscomplete.completion.preserve.bounds import are_within_bounds, preserve_hard
from gscomplete.completion.preserve.outcome import HardPreservationReport
from gscomplete.completion.seam import SeamColorReport, match_seam_colors
from gscomplete.completion.settings import CompletionSettings
from gscomplete.completion.start import start_splats
from gscomplete.errors import naming
from gscomplete.evaluate.doubts import (
    doubts_of_guess,
    doubts_of_partial,
    doubts_of_result,
    doubts_of_values,
)
from gscomplete.framing.check import (
    check_given_frame,
    describe_frame,
    largest_side,
    require_visible,
)
from gscomplete.framing.decide import Framing, FramingRequest, decide_framing
from gscomplete.framing.input_view import SettledView, given_view, refine_input_view
from gscomplete.priors.base import Conditioning, KnowsShapes, Prior, prior_identity
from gscomplete.shape.mirror_plane import HalfCut
from gscomplete.splats import (
    SplatFile,
    Splats,
    append_splats,
    concatenate,
    transform_splats,
    write_splats,
)
from gscomplete.splats.formats.any_file import read_splat_file
from gscomplete.splats.oklab import color_spread
from gscomplete.splats.slits import slit_splats
from gscomplete.splats.suspects import describe_suspects
from gscomplete.splats.working_set import WorkingSet, without_far, working_set
from gscomplete.util.device import plain_torch
from gscomplete.util.jsonio import to_json
from gscomplete.util.stages import stage
from gscomplete.views import ObjectFrame, ViewDistribution, radius_to_fit
from gscomplete.views.frame import up_rotation

MAX_WORKING_SPLATS = 250_000
"""Most splats of P that are drawn while optimising; all are in the output."""


@dataclass(frozen=True, slots=True)
class Request:
    """What is to be done with a part: prompt, settings, and what is known of its frame."""

    prompt: str
    """What the complete object is."""
    settings: CompletionSettings
    """Every knob of the method."""
    framing: FramingRequest = dataclasses.field(default_factory=FramingRequest)
    """What the user says about frame and views; the rest is guessed."""
    negative_prompt: str | None = None
    """What guidance leads away from, "" = nothing; None = the prior's default."""


@dataclass(frozen=True, slots=True)
class Prepared:
    """A completion about to take its steps."""

    request: Request
    working: WorkingSet
    """The splats of P that take part, file frame."""
    frame: ObjectFrame
    partial: Splats
    """The same in the object frame, on the CPU."""
    heeded: Splats
    """All of them but strays and table: what guesses are made from."""
    guessed_views: ViewDistribution
    """V that the prior's guess was made with: given, or guessed from P alone."""
    views: ViewDistribution
    """V that the steps keep P's appearance from."""
    prior: Prior
    conditioning: Conditioning
    steps: Optimisation
    notes: tuple[str, ...]
    """What was decided and why, for the user."""
    doubts: tuple[str, ...]
    """Those of the notes that make the guess doubtful (``evaluate.doubts``)."""

    @property
    def identity(self) -> dict[str, Any]:
        """Everything but P that decides the result, as JSON values."""
        settings = to_json(self.request.settings)
        del settings["checkpoint_every"]  # decides nothing about the result
        return {
            "prompt": self.request.prompt,
            "negative_prompt": self.request.negative_prompt,
            "prior": prior_identity(self.prior),
            "frame": self.frame.to_json(),
            "views": self.views.to_json(),
            "settings": settings,
        }


@dataclass(frozen=True, slots=True)
class Completed:
    """A completed object."""

    given: SplatFile | Splats
    """P as given, file frame."""
    partial: Splats
    """The splats of P that took part, object frame."""
    new: Splats
    """The new splats, object frame."""
    frame: ObjectFrame
    """How the object frame lies in the file frame."""
    views: ViewDistribution
    """V, from whose views P keeps its appearance."""
    notes: tuple[str, ...]
    """What was decided and why, a line each."""
    doubts: tuple[str, ...]
    """Those of the notes that make the result doubtful (``evaluate.doubts``)."""
    seam_colors: SeamColorReport | None
    """What matching colours at the seam did; None = not asked for."""
    hard_preservation: HardPreservationReport | None
    """What the bounds on E_color and E_depth took; None = no bounds."""
    seconds: float
    """From P to the new splats; of ``finish``, what it took itself."""

    @property
    @plain_torch()
    def new_in_file(self) -> Splats:
        """The new splats in the file frame."""
        return transform_splats(self.new, self.frame.file_from_object)

    @property
    def splats(self) -> Splats:
        """O in the file frame, on the CPU: P's splats first, as given, new ones after."""
        given = self.given.splats if isinstance(self.given, SplatFile) else self.given
        return concatenate([given.to("cpu"), self.new_in_file])

    @property
    def in_object_frame(self) -> Splats:
        """The splats of P that took part and the new ones, object frame."""
        return concatenate([self.partial, self.new])

    def save(self, path: str | Path) -> None:
        """Write O as a PLY file: the bytes of P's file first, where P came from one.

        Raises:
            UserError: the file cannot be written, or P's file cannot hold the new splats.
        """
        comments = (
            f"gscomplete version {gscomplete.__version__}",
            f"gscomplete new_splats {len(self.new)}",
        )
        if isinstance(self.given, SplatFile):
            append_splats(path, self.given, self.new_in_file, comments)
        else:
            write_splats(path, self.splats, comments)

    def save_new(self, path: str | Path) -> None:
        """Write the new splats alone, file frame, as a PLY file.

        Raises:
            UserError: the file cannot be written.
        """
        write_splats(path, self.new_in_file, (f"gscomplete version {gscomplete.__version__}",))


@plain_torch()
def complete(
    partial: SplatFile | Splats | str | Path,
    request: Request,
    prior: Prior,
    device: torch.device | str = "cpu",
    on_step: Callable[[StepReport], None] | None = None,
) -> Completed:
    """Complete a partial object made of Gaussian splats (the paper's O from P, y and V).

    Args:
        partial: P: a splat file, read or its path, or splats in the file frame.
        request: what to make of it.
        prior: the model that guides.
        device: where splats are rendered and moved; the prior may run on another.
        on_step: called after every optimiser step.

    Returns:
        P and what was added, with frame, V and the reasons of what was guessed.

    Raises:
        UserError: the file or the request is wrong, or the prior cannot start.
    """
    started = time.perf_counter()
    given = partial if isinstance(partial, Splats | SplatFile) else read_splat_file(partial)
    prepared = prepare(given, request, prior, device)
    while not prepared.steps.finished:
        report = prepared.steps.step()
        if on_step is not None:
            on_step(report)
    return dataclasses.replace(finish(prepared, given), seconds=time.perf_counter() - started)


@plain_torch()
def prepare(
    given: SplatFile | Splats, request: Request, prior: Prior, device: torch.device | str = "cpu"
) -> Prepared:
    """Do all that comes before the first step.

    Args:
        given: P in the file frame.
        request: what to make of it.
        prior: the model that guides.
        device: where splats are rendered and moved; the prior may run on another.

    Raises:
        UserError: P cannot be drawn, the frame given is not P's, or the prior cannot start.
    """
    settings, framing_request = request.settings, request.framing
    if isinstance(settings.mirror, HalfCut):
        toward_deg = settings.mirror.toward_deg
        framing_request = dataclasses.replace(
            framing_request, is_half=True, half_toward_deg=toward_deg
        )
    notes: tuple[str, ...] = ()
    if isinstance(given, SplatFile):
        splats, name = given.splats, str(given.path)
        notes += tuple(f"{name}: {warning}" for warning in given.warnings)
    else:
        splats, name = given, "P"
    drawable = splats.detach().to("cpu", torch.float32)
    turn = up_rotation(framing_request.up) if settings.leave_out_strays else None
    with stage("strays"):
        working = working_set(drawable, MAX_WORKING_SPLATS, name, turn)
    notes += describe_suspects(working.heeded)
    with stage("frame"), naming(name):
        framing = framing_for(working.heeded, framing_request, prior)
    notes += framing.notes
    if framing_request.center_file is not None or framing_request.size_file is not None:
        notes += check_given_frame(working.heeded, framing.frame, name)
    working = without_far(working, framing.frame.object_from_file)
    notes += (*describe_frame(framing.frame, framing.views), working.summary)
    partial, heeded = (
        transform_splats(splats, framing.frame.object_from_file).detach().to("cpu")
        for splats in (working.splats, working.heeded)
    )
    require_visible(partial, framing.views, name)
    diameter = largest_side(working.heeded) / framing.frame.size_file
    conditioning = prior.condition(request.prompt, request.negative_prompt)
    if not settings.see_input and settings.known_shapes and isinstance(prior, KnowsShapes):
        conditioning = prior.with_known_shape(conditioning, heeded, framing.views)
    with stage("start"):
        start = start_splats(heeded, prior, conditioning, framing.views, settings, diameter)
    settled = SettledView(framing.views, 0.0)
    if start.is_guess:
        settle = refine_input_view if framing_request.view_deg is None else given_view
        with stage("input view"):
            settled = settle(heeded, start.splats, framing.views)
    views = settled.views
    skipped: tuple[str, ...] = ()
    if settings.steps and settings.least_color_spread:
        settings, skipped = _without_idle_steps(settings, partial)
    steps = Optimisation(partial, start.splats, prior, conditioning, views, settings, device)

    report = () if settings.start == "fill" else conditioning.report  # gaps heed no prompt
    notes += (start.note, *filter(None, (settled.note,)), *skipped, *report)
    is_size_given = framing_request.size_file is not None
    doubts = doubts_of_values(drawable) + doubts_of_partial(heeded, is_size_given=is_size_given)
    doubts += doubts_of_guess(settled.hidden_share)
    notes += doubts
    if request.negative_prompt and not steps.heeds_negative_prompt:
        notes += ("negative prompt: has no effect in this run; this prior needs --text-only",)
    return Prepared(
        request,
        working,
        framing.frame,
        partial,
        heeded,
        framing.views,
        views,
        prior,
        conditioning,
        steps,
        notes,
        doubts,
    )


def _without_idle_steps(
    settings: CompletionSettings, partial: Splats
) -> tuple[CompletionSettings, tuple[str, ...]]:
    """Drop the steps if P's colours vary too little for them, and tell the user."""
    spread, least = color_spread(partial), settings.least_color_spread
    if spread >= least:
        return settings, ()
    note = (
        f"no steps are taken: P has nearly one colour (spread {spread:.3f} in Oklab, steps need at "
        f"least {least:g}), and the new splats keep it"
    )
    return dataclasses.replace(settings, steps=0), (note,)


def framing_for(splats: Splats, request: FramingRequest, prior: Prior) -> Framing:
    """Decide frame and V: its cameras show as much of the object as the prior's do on average.

    Args:
        splats: P in the file frame.
        request: what is given.
        prior: the model that guides.

    Raises:
        UserError: a guess is needed and P has no finite splat or no extent.
    """
    lens = prior.views
    radius = radius_to_fit(lens.mean_extent, lens.fov_deg)
    return decide_framing(splats, request, radius=radius, fov_deg=lens.fov_deg)


@plain_torch()
def finish(prepared: Prepared, given: SplatFile | Splats) -> Completed:
    """Do what follows the last step: match colours, close slits, hold P's appearance to bounds.

    Splats that close P's slits count as P's own when bounds are enforced, so that they stay.

    Args:
        prepared: a completion whose steps are taken.
        given: P as given.
    """
    started = time.perf_counter()
    settings, partial = prepared.request.settings, prepared.partial
    new = prepared.steps.new_splats.to("cpu")
    notes = prepared.notes
    colors, bounds = None, None
    if settings.match_seam_colors:
        with stage("seam"):
            new, colors = match_seam_colors(new, partial)
        notes += (colors.summary,)
    slits, found = _slits(prepared)
    notes += found
    if settings.hard_preservation is not None:
        closed = concatenate([partial, slits])
        with stage("preservation"):
            bounded = preserve_hard(
                new, closed, prepared.views, settings.hard_preservation, settings.seed
            )
        new, bounds = bounded.splats, bounded.report
        notes += (bounds.summary,)
    doubts = prepared.doubts
    if settings.start == "guess":
        found = doubts_of_result(prepared.heeded, new, None if bounds is None else bounds.lost)
        doubts, notes = doubts + found, notes + found
    new = concatenate([new, slits])
    seconds = time.perf_counter() - started
    return Completed(
        given, partial, new, prepared.frame, prepared.views, notes, doubts, colors, bounds, seconds
    )


def _slits(prepared: Prepared) -> tuple[Splats, tuple[str, ...]]:
    """Return the splats that close the slits of a scan, and a note for the user."""
    settings, partial, views = prepared.request.settings, prepared.partial, prepared.views
    nothing = partial.with_sh_degree(0).select(torch.arange(0))
    if not settings.close_slits:
        return nothing, ()
    with stage("slits"):
        slits = slit_splats(prepared.heeded, views.eye())
    if not len(slits):
        return nothing, ()
    bounds = settings.hard_preservation
    # Bounds that do not apply where P is thin do not apply to its slits either.
    held = None if bounds is None or bounds.mask_from else bounds
    if held is not None and not are_within_bounds(slits, partial, views, held, settings.seed):
        return nothing, (
            "slits of the scan: left open, as closing them changes P's appearance too much",
        )
    return slits, (
        f"slits of the scan: {len(slits):,} splats close them (--no-close-slits does not)",
    )
