"""What a completion starts from: given by options, by the object folder, or left to be guessed.

Conventions
-----------
* An option overrides the object folder; what neither says is a default, or guessed from P.
* Of the folder's frame, centre and size are taken only where they are known without the truth.
* ``sources`` says which came from where, and goes into ``run.json``.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from gscomplete.cli.complete_options import CompleteOptions, HowToComplete, require_plain_fill
from gscomplete.completion.pipeline import Request
from gscomplete.completion.presets import FILL, preset
from gscomplete.completion.run_folder import RunRequest
from gscomplete.completion.settings import CompletionSettings, HardPreservationSettings
from gscomplete.errors import UserError
from gscomplete.folders import OBJECT_FILE, ObjectFolder, object_folder_of
from gscomplete.framing.decide import FramingRequest
from gscomplete.priors.base import Prior, ShapePrior
from gscomplete.shape.mirror_plane import ChosenMirror, HalfCut, MirrorPlane
from gscomplete.util.file_names import PARTIAL_FILE
from gscomplete.util.parse import parse_numbers, parse_view, require_prompt, require_text
from gscomplete.views import UpAxis, parse_up
from gscomplete.views.distribution import AZIMUTH_RANGE_DEG, ELEVATION_RANGE_DEG

DEFAULT_UP: UpAxis = "Z"
_MIXED_AT_EDGES = ("lidar", "singleview")
"""Subsets whose colours at P's edges may be mixed with those of what stood behind it."""
_TRAINED = "multiview"
"""Subset whose splats are trained from photos."""
_STORES = (("http:",), ("https:",), ("s3:",), ("gs:",))
"""First parts of addresses as paths have them."""
_ANYTHING = "an object"
"""Prompt of what is completed without one."""


@dataclass(frozen=True, slots=True)
class Options:
    """The options that an object folder can supply instead; None = not given."""

    path: Path
    """A splat file, an object folder, or a file that such a folder records."""
    prompt: str | None = None
    up: UpAxis | None = None
    view_deg: tuple[float, float] | None = None
    range_deg: float | None = None
    center_file: tuple[float, float, float] | None = None
    size_file: float | None = None
    needs_prompt: bool = True
    """Without one, and without an object folder that says it: an error, or else no matter."""


@dataclass(frozen=True, slots=True)
class Given:
    """What a completion starts from; None = to be guessed."""

    partial: Path
    prompt: str
    up: UpAxis
    view_deg: tuple[float, float] | None
    azimuth_range_deg: float
    elevation_range_deg: float
    center_file: tuple[float, float, float] | None
    size_file: float | None
    object_folder: Path | None
    sources: dict[str, str]
    """For prompt, up, input_view, V, center and size: the option, object.json, default or guess."""
    notes: tuple[str, ...]
    """What of the object folder was set aside."""
    subset: str | None
    """Kind of the object's source; None = unknown."""
    captured: bool
    """Whether object.json says that P was trained from photos, and not cut from a known object."""


def request_of(options: CompleteOptions, prior: Prior) -> RunRequest:
    """Turn command-line options into a request.

    Raises:
        UserError: an option has the wrong form.
    """
    given = given_to(options)
    require_text(options.negative_prompt, "--negative-prompt")
    settings = settings_of(options, prior)
    if options.edge_colors == "auto" and given.subset in _MIXED_AT_EDGES:
        settings = dataclasses.replace(settings, mixed_edge_colors=True)
    if options.captured == "auto" and given.captured:
        settings = dataclasses.replace(settings, captured=True)
    framing = FramingRequest(
        given.up,
        given.view_deg,
        given.azimuth_range_deg,
        given.center_file,
        given.size_file,
        elevation_range_deg=given.elevation_range_deg,
    )
    completion = Request(given.prompt, settings, framing, options.negative_prompt)
    name = given.partial.stem if given.object_folder is None else given.object_folder.resolve().name
    return RunRequest(
        given.partial,
        options.out or Path(f"{name}_completed"),
        completion,
        options.resume,
        options.alternatives,
        given.object_folder,
        given.sources,
        given.notes,
        options.new_only,
    )


def settings_of(options: HowToComplete, prior: Prior) -> CompletionSettings:
    """Turn the options that say how to complete into the method's settings.

    Raises:
        UserError: an option has the wrong form.
    """
    chosen = FILL if options.fill else preset(options.preset, prior, text_only=options.text_only)
    settings = dataclasses.replace(chosen, seed=options.seed)
    if options.fill:
        require_plain_fill(options)
    if options.steps is not None:
        if options.steps < 0:
            raise UserError(f"--steps: expected at least 0, found {options.steps}")
        settings = _stretched(settings, options.steps)
    if options.checkpoint_every is not None:
        settings = dataclasses.replace(settings, checkpoint_every=options.checkpoint_every)
    bounds = parse_numbers(options.preserve, 2, "--preserve", "COLOR,DEPTH")
    if bounds is not None:
        if min(bounds) <= 0:
            raise UserError(f"--preserve: expected positive bounds, found {options.preserve!r}")
        hard = HardPreservationSettings(color_bound=bounds[0], depth_bound=bounds[1])
        settings = dataclasses.replace(settings, hard_preservation=hard)
    if options.edge_colors == "ignore":
        settings = dataclasses.replace(settings, mixed_edge_colors=True)
        _require_guess("--edge-colors", options, settings, prior)
    if options.captured == "yes":
        settings = dataclasses.replace(settings, captured=True)
        _require_guess("--captured", options, settings, prior)
    if not options.leave_out_strays:
        settings = dataclasses.replace(settings, leave_out_strays=False)
    if not options.close_slits:
        settings = dataclasses.replace(settings, close_slits=False)
    if options.match_seam:
        settings = dataclasses.replace(settings, match_seam_colors=True)
    if options.mirror != "guess":
        settings = dataclasses.replace(settings, mirror=_mirror(options.mirror))
        _require_guess("--mirror", options, settings, prior)
    settings = dataclasses.replace(settings, known_shapes=options.known_shapes)
    if options.prompt_decides:
        if not options.known_shapes:
            raise UserError("--prompt-decides: uses known shapes; expected no --no-known-shapes")
        if options.alternatives:
            raise UserError("--prompt-decides: uses no mirror planes; expected no --alternatives")
        if isinstance(settings.mirror, HalfCut):
            raise UserError("--prompt-decides: a known shape completes P; expected no --mirror cut")
        settings = dataclasses.replace(settings, prompt_decides=True)
        _require_guess("--prompt-decides", options, settings, prior)
    if not 0 <= options.alternatives <= 8:
        raise UserError(f"--alternatives: expected 0 to 8, found {options.alternatives}")
    if options.alternatives:
        _require_guess("--alternatives", options, settings, prior)
    return settings


def given_to(options: CompleteOptions) -> Given:
    """Join the options with what the object folder says."""
    center = parse_numbers(options.center, 3, "--center", "X,Y,Z")
    return take_given(
        Options(
            options.partial,
            options.prompt,
            options.up,
            parse_view(options.view),
            options.range,
            None if center is None else (center[0], center[1], center[2]),
            options.size,
            needs_prompt=not options.fill,
        )
    )


def _require_guess(
    name: str, options: HowToComplete, settings: CompletionSettings, prior: Prior
) -> None:
    """Refuse an option about guesses where there is none.

    Raises:
        UserError: the run starts without a guess of the complete object.
    """
    if settings.start != "guess" or not isinstance(prior, ShapePrior):
        raise UserError(
            f"{name}: expected a run that starts from a guess of the complete object (--preset "
            f"default, fast or reconstruct with the embedded prior), found preset {options.preset} "
            f"with prior {prior.name}{' and --text-only' if options.text_only else ''}"
        )


def _mirror(text: str) -> ChosenMirror:
    """Parse a plane of symmetry.

    Raises:
        UserError: it has the wrong form.
    """
    if text == "none":
        return "none"
    form = "guess, none, cut, cut:AZIMUTH or AZIMUTH,OFFSET"
    word, colon, azimuth = text.partition(":")
    if word == "cut":
        toward = parse_numbers(azimuth if colon else None, 1, "--mirror", form)
        return HalfCut(*(toward or ()))
    numbers = parse_numbers(text, 2, "--mirror", form)
    assert numbers is not None
    return MirrorPlane(*numbers)


def _stretched(settings: CompletionSettings, steps: int) -> CompletionSettings:
    """Return the settings for another number of steps; all step counts scale in proportion.

    Presets without steps are returned unchanged.
    """
    if settings.steps == 0 or steps == 0:
        return dataclasses.replace(settings, steps=steps)
    share = steps / settings.steps
    every = max(1, round(share * settings.densify.every))
    return dataclasses.replace(
        settings,
        steps=steps,
        warmup_steps=round(share * settings.warmup_steps),
        densify=dataclasses.replace(settings.densify, every=every),
    )


def take_given(options: Options) -> Given:
    """Join options and object folder.

    Raises:
        UserError: the path is a folder without a part, the prompt is missing, or an option is
            wrong.
    """
    if options.path.parts[:1] in _STORES:
        raise UserError(
            f"{options.path}: expected a file or folder of this machine, found an address "
            "(gscomplete batch reads from stores)"
        )
    found = object_folder_of(options.path)
    if found is None and options.path.is_dir():
        raise UserError(
            f"{options.path}: expected a splat file or an object folder with {OBJECT_FILE}, found "
            "another folder"
        )
    if found is not None and found.partial.name not in found.files:
        raise UserError(f"{found.folder}: expected a {found.partial.name}, found none recorded")
    sources: dict[str, str] = {}
    notes: list[str] = []
    means_folder = options.path.is_dir() or options.path.name in (OBJECT_FILE, PARTIAL_FILE)
    if found is not None and not means_folder:
        notes.append(
            f"{options.path}: {found.partial}, the part of its object folder, is completed instead"
        )
    if found is not None and found.is_replaced(found.partial):
        notes.append(
            f"doubtful: {found.partial} is not the file that {OBJECT_FILE} records; what that says "
            "may be of another object (--prompt, --up, --view and others give it)"
        )
    up = _up(options, found, sources)
    view = options.view_deg
    if view is not None:
        sources["input_view"] = "--view"
    elif found is None:
        sources["input_view"] = "guess"
    elif found.frame.up != up:
        sources["input_view"] = "guess"
        notes.append(
            f"{found.folder / OBJECT_FILE}: its input view is for up axis {found.frame.up}, not "
            f"{up}, so the input view is guessed (--view gives one)"
        )
    else:
        view = found.views.azimuth_deg, found.views.elevation_deg
        sources["input_view"] = OBJECT_FILE
    center, size = _box(options, found, sources)
    return Given(
        options.path if found is None else found.partial,
        _prompt(options, found, sources),
        up,
        view,
        _range(options, found, sources),
        ELEVATION_RANGE_DEG if found is None else found.views.elevation_range_deg,
        center,
        size,
        None if found is None else found.folder,
        sources,
        tuple(notes),
        None if found is None else found.subset,
        found is not None and found.subset == _TRAINED and found.complete is None,
    )


def _prompt(options: Options, found: ObjectFolder | None, sources: dict[str, str]) -> str:
    """Return the prompt.

    Raises:
        UserError: there is none, or it is empty or no Unicode text.
    """
    require_prompt(options.prompt)
    if options.prompt is not None:
        sources["prompt"] = "--prompt"
        return options.prompt
    if found is None and not options.needs_prompt:
        sources["prompt"] = "default"
        return _ANYTHING
    if found is None and not options.path.exists():
        raise UserError(f"{options.path}: expected a splat file or an object folder, found none")
    if found is None:
        raise UserError(
            f'--prompt: expected a name of the complete object, such as "a red mug", found none; '
            f"{options.path} belongs to no object folder that has one"
        )
    sources["prompt"] = OBJECT_FILE
    return found.prompt


def _up(options: Options, found: ObjectFolder | None, sources: dict[str, str]) -> UpAxis:
    """Return the up axis.

    Raises:
        UserError: it is none.
    """
    if options.up is not None:
        sources["up"] = "--up"
        return parse_up(options.up) or DEFAULT_UP
    sources["up"] = "default" if found is None else OBJECT_FILE
    return DEFAULT_UP if found is None else found.frame.up


def _range(options: Options, found: ObjectFolder | None, sources: dict[str, str]) -> float:
    """Return V's range of azimuths.

    Raises:
        UserError: it is out of range.
    """
    if options.range_deg is not None:
        if not 0 <= options.range_deg <= 180:
            raise UserError(f"--range: expected 0 to 180 degrees, found {options.range_deg:g}")
        sources["V"] = "--range"
        return options.range_deg
    sources["V"] = "default" if found is None else OBJECT_FILE
    return AZIMUTH_RANGE_DEG if found is None else found.views.azimuth_range_deg


def _box(
    options: Options, found: ObjectFolder | None, sources: dict[str, str]
) -> tuple[tuple[float, float, float] | None, float | None]:
    """Return centre and size of the complete object where they are known.

    Raises:
        UserError: an option has the wrong form.
    """
    center = None if found is None else found.known_center
    size = None if found is None else found.known_size
    sources["center"] = "guess" if center is None else OBJECT_FILE
    sources["size"] = "guess" if size is None else OBJECT_FILE
    if options.center_file is not None:
        center, sources["center"] = options.center_file, "--center"
    if options.size_file is not None:
        size, sources["size"] = options.size_file, "--object-size"
    return center, size
