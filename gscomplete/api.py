"""Complete an object from Python; prior and settings are chosen as the command chooses them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

from gscomplete.completion import pipeline
from gscomplete.completion.optimise import StepReport
from gscomplete.completion.presets import PresetName, preset
from gscomplete.completion.settings import CompletionSettings
from gscomplete.errors import UserError
from gscomplete.framing.decide import FramingRequest
from gscomplete.priors import load_prior, require_prior
from gscomplete.priors.base import Prior
from gscomplete.render.dispatch import choose_render_device
from gscomplete.splats import SplatFile, Splats, usable_rows
from gscomplete.splats.filters import in_words
from gscomplete.util.device import choose_device
from gscomplete.util.file_names import PARTIAL_FILE
from gscomplete.views import UpAxis
from gscomplete.views.distribution import AZIMUTH_RANGE_DEG, ELEVATION_RANGE_DEG


def complete(
    partial: SplatFile | Splats | str | Path,
    prompt: str,
    *,
    prior: Prior | str | Path = "embedded",
    preset_name: PresetName = "default",
    settings: CompletionSettings | None = None,
    up: UpAxis = "Z",
    view_deg: tuple[float, float] | None = None,
    azimuth_range_deg: float = AZIMUTH_RANGE_DEG,
    elevation_range_deg: float = ELEVATION_RANGE_DEG,
    center_file: tuple[float, float, float] | None = None,
    size_file: float | None = None,
    negative_prompt: str | None = None,
    seed: int = 0,
    device: str = "auto",
    on_step: Callable[[StepReport], None] | None = None,
) -> pipeline.Completed:
    """Complete a partial object made of Gaussian splats (the paper's O from P, y and V).

    Args:
        partial: P: a splat file, read (``read_splats``) or its path, or splats in the file frame
            (any scale; ``up`` points up). An ``object.json`` beside a file is not read: what it
            says are arguments here.
        prompt: what the complete object is, such as "a red mug".
        prior: a loaded prior (``load_prior``; load it once to complete many), or what ``--prior``
            takes: ``embedded``, ``mvdream``, or the path of weights.
        preset_name: named settings: default, fast, reconstruct, distill, paper.
        settings: every knob; None = those of ``preset_name``. Their own seed counts.
        up: axis of the file frame that points up.
        view_deg: azimuth and elevation of the input view c in degrees; None = guessed.
        azimuth_range_deg: V reaches this far to either side of c.
        elevation_range_deg: and this far above and below c.
        center_file: centre of the complete object in file coordinates; None = guessed.
        size_file: its largest side in file units; None = guessed.
        negative_prompt: what to lead away from; None = the prior's default.
        seed: same seed, same bytes.
        device: ``cpu``, ``cuda``, ``cuda:N`` or ``auto``.
        on_step: called after every optimiser step; the embedded prior's default preset has none.

    Returns:
        P and what was added, with frame, V and the reasons of what was guessed.

    Raises:
        UserError: the input, an option, the prior or its weights are wrong.
    """
    if isinstance(partial, str | Path) and Path(partial).is_dir():
        raise UserError(
            f"{partial}: expected a splat file, found a folder; name the {PARTIAL_FILE} in it, and "
            "give what its object.json says as arguments"
        )
    if not isinstance(prompt, str):
        raise UserError(f"prompt: expected a text, found {prompt!r}")
    if not isinstance(negative_prompt, str | None):
        raise UserError(f"negative_prompt: expected a text, found {negative_prompt!r}")
    if isinstance(partial, Splats):
        _require_drawable(partial)
    chosen_device = choose_device(device)
    render_device, _ = choose_render_device(device, chosen_device)
    if isinstance(prior, str | Path):
        prior = load_prior(str(prior), chosen_device)
    require_prior(prior, "prior")
    if settings is None:
        settings = dataclasses.replace(preset(preset_name, prior), seed=seed)
    framing = FramingRequest(
        up,
        view_deg,
        azimuth_range_deg,
        center_file,
        size_file,
        elevation_range_deg=elevation_range_deg,
    )
    request = pipeline.Request(prompt, settings, framing, negative_prompt)
    return pipeline.complete(partial, request, prior, render_device, on_step)


def _require_drawable(partial: Splats) -> None:
    """Refuse splats that no file could hold, before anything is computed for them.

    Raises:
        UserError: a value is not finite or out of range.
    """
    usable, reasons = usable_rows(partial)
    if not bool(usable.all()):
        raise UserError(
            f"partial: expected splats that can be drawn, found {in_words(reasons)}: leave these "
            "out (gscomplete.splats.usable_rows)"
        )
