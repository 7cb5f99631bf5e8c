"""What the commands share: their common flags, the writing of the object, reports, progress.

Conventions
-----------
* A command's option class inherits ``ObjectOptions`` and adds its own; a ``run(options)`` turns
  it into a call of a Python function of the package and hands the result to ``finish_object``.
* People's lines go to standard output, or to standard error when that is for ``--json``.
* Options that decide nothing about the result (``NOT_RECORDED``) are left out of the record.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import shlex
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gscomplete.cli.bars import progress_bar
from gscomplete.errors import UserError, naming
from gscomplete.util import jsonio
from gscomplete.util.file_names import is_plain_name, shown_name
from gscomplete.util.parse import (
    has_controls,
    parse_numbers,
    parse_view,
    require_prompt,
    shown_text,
)

if TYPE_CHECKING:
    from PIL import Image

    from gscomplete.framing.decide import FramingRequest
    from gscomplete.splats import Similarity, Splats
    from gscomplete.views import UpAxis
    from splatcomplete_data.cuts.boxes import CropBox
    from splatcomplete_data.objects import ObjectRecord, StepRecord, Subset

NOT_RECORDED = ("out", "json", "overwrite", "prompt", "licence", "origin", "id")
"""Options that are not repeated in ``object.json``'s options: they have fields of their own, or
decide nothing."""

Report = Callable[[int, int], None]
"""Progress callback: (done, total) in whatever unit the step counts."""


StageCallback = Callable[[str, float], None]
"""Says that a stage begins: (what is done now, share of the work that is behind, 0 to 1)."""


def ignore_stage(name: str, share: float) -> None:
    """Ignore a stage; the ``StageCallback`` of callers that show no progress."""


@dataclass(frozen=True, kw_only=True)
class ObjectOptions:
    """Flags of every command that writes an object folder."""

    out: Path | None = None
    """Object folder to write; None = the source's name, in the current folder."""
    prompt: str | None = None
    """Names the complete object, such as "a red mug"; None = the source's file name as words."""
    view: str | None = None
    """Input view c as AZIMUTH,ELEVATION in degrees (azimuth 0 looks from +x of the z-up object
    frame, 90 from +y); None = the camera's own view where there is one, else the view that shows
    most of the part from outside."""
    range: float = 50.0
    """Degrees of azimuth that V extends to either side of c."""
    up: str = "auto"
    """Axis of the source that points up, X, Y, Z, -X, -Y or -Z, or a direction X,Y,Z; auto = by the
    kind of source, as described above."""
    center: str | None = None
    """Centre of the COMPLETE object as X,Y,Z in the source's coordinates (as --box), even if an
    offset or --level moves the splats; None = known or guessed."""
    object_size: float | None = None
    """Largest side of the COMPLETE object in the source's units; None = known or guessed."""
    id: str | None = None
    """Name within a dataset; None = the folder's name."""
    licence: str | None = None
    """Licence of the source; recorded."""
    origin: str | None = None
    """Origin of the source, such as a URL; recorded."""
    overwrite: bool = False
    """Replace --out if it exists."""
    json: bool = False
    """Print only the content of object.json on standard output, plus complete_command: the shell
    command that completes the part (null without a part)."""


@dataclass(frozen=True, slots=True, eq=False)
class ObjectDraft:
    """What a pipeline made, before frame and record are decided."""

    subset: Subset
    source_file: Path
    partial: Splats | None
    """The part, file frame; None = only the complete object was asked for."""
    complete: Splats | None
    default_up: UpAxis
    steps: tuple[StepRecord, ...] = ()
    notes: tuple[str, ...] = ()
    boxes: tuple[CropBox, ...] = ()
    splat_size: float | None = None
    camera_position_file: tuple[float, float, float] | None = None
    """Where the source was seen from, in the file frame; gives the default input view."""
    file_from_source: Similarity | None = None
    is_center_of_source: bool = False
    """Whether ``--center`` lies in the source's frame and is moved along; else in the file's."""
    details: dict[str, Any] = dataclasses.field(default_factory=dict)
    partial_file: Path | None = None
    """PLY whose bytes are the part; None = written anew."""
    extra_pictures: dict[str, Image.Image] = dataclasses.field(default_factory=dict)


def finish_object(options: ObjectOptions, made: ObjectDraft) -> int:
    """Decide frame and views, write the folder, report; return the exit code.

    Raises:
        UserError: an option is wrong, nothing is left, or the folder cannot be written.
    """
    return report_object(options, made, store_object(options, made))


def report_object(options: ObjectOptions, made: ObjectDraft, record: ObjectRecord) -> int:
    """Tell what was made and written; return the exit code."""
    folder = options.out or default_folder(made.source_file)
    command = complete_command(folder, record)
    if options.json:
        content = {**record.to_json(), "complete_command": command}
        sys.stdout.write(json.dumps(content) + "\n")
        return 0
    for step in record.steps:
        say(options, step.summary())
    say(options, *record.notes)
    x, y, z = record.frame.center_file
    say(
        options,
        f"frame ({record.frame_origin}): up {record.frame.up}, centre {x:.6g},{y:.6g},{z:.6g}, "
        f"size {record.frame.size_file:.6g}; input view {record.views.azimuth_deg:g},"
        f"{record.views.elevation_deg:g} +/-{record.views.azimuth_range_deg:g} degrees",
        f"written: {folder} ({', '.join(f'{n:,} {k}' for k, n in record.counts.items())})",
    )
    if command is not None:
        say(options, f"complete it: {command}")
    return 0


def complete_command(folder: Path, record: ObjectRecord) -> str | None:
    """Return the shell's line that completes an object's part; None = it has none.

    ``gscomplete`` reads prompt, up axis, input view and V from the folder. Its guesses of centre
    and size are as good as the record's, but for single views and scans: it does not know where
    the camera stood.
    """
    from splatcomplete_data.objects import PARTIAL_FILE

    if PARTIAL_FILE not in record.files:
        return None
    frame: tuple[str, ...] = ()
    if record.subset in ("singleview", "lidar") and record.frame_origin != "truth":
        center = ",".join(f"{value:.6g}" for value in record.frame.center_file)
        frame = (f"--center={center}", f"--object-size={record.frame.size_file:.6g}")
    out = ("--out", f"{folder}_completed")
    return shlex.join(("gscomplete", "complete", str(folder), *frame, *out))


def store_object(options: ObjectOptions, made: ObjectDraft) -> ObjectRecord:
    """Decide frame and views and write the folder; return the record.

    Raises:
        UserError: as ``finish_object``.
    """
    from gscomplete.framing.decide import decide_framing
    from gscomplete.util.digests import sha256_of
    from splatcomplete_data.framing import moved_center, require_touching, seen_past_truth
    from splatcomplete_data.objects import ObjectRecord, SourceRecord, write_object

    folder = options.out or default_folder(made.source_file)
    drawn = made.partial if made.partial is not None else made.complete
    if drawn is None or len(drawn) == 0:
        raise UserError(f"{made.source_file}: no splats are left to write")
    request = dataclasses.replace(
        framing_request(options, made.default_up),
        camera_position_file=made.camera_position_file,
        is_one_camera=made.subset in ("singleview", "lidar"),
    )
    turn = made.file_from_source
    given_in = turn if made.is_center_of_source else None
    if given_in is not None:
        request = moved_center(request, given_in)
    with naming(made.source_file):
        decided = decide_framing(drawn, request, made.complete)
    if request.center_file is not None or request.size_file is not None:
        require_touching(decided.frame, drawn, given_in)
    if request.view_deg is None and request.camera_position_file is None:
        decided = seen_past_truth(decided, made.partial, made.complete)
    is_file = made.source_file.is_file()
    try:
        record = ObjectRecord(
            id=shown_name(folder.name) if options.id is None else options.id,
            subset=made.subset,
            prompt=options.prompt or _prompt_from(made.source_file),
            source=SourceRecord(
                made.source_file.as_posix(),
                sha256_of(made.source_file) if is_file else None,
                options.licence,
                options.origin,
            ),
            frame=decided.frame,
            frame_origin=decided.origin,
            frame_given=decided.given,
            views=decided.views,
            file_from_source=None if turn is None else turn.to_json(),
            boxes=made.boxes,
            splat_size=made.splat_size,
            steps=made.steps,
            notes=(*made.notes, *decided.notes),
            details=made.details,
            options=recorded_options(options),
        )
    except ValueError as error:
        raise UserError(f"{folder}: {error}") from error
    return write_object(
        folder,
        record,
        made.partial,
        made.complete,
        overwrite=options.overwrite,
        partial_file=made.partial_file,
        pictures=made.extra_pictures,
    )


def framing_request(options: ObjectOptions, default_up: UpAxis) -> FramingRequest:
    """Parse the flags about frame and views into a ``FramingRequest``.

    Raises:
        UserError: a flag has the wrong form.
    """
    from gscomplete.framing.decide import FramingRequest
    from gscomplete.views import parse_up

    view = parse_view(options.view)
    center = parse_numbers(options.center, 3, "--center", "X,Y,Z")
    if not 0 <= options.range <= 180:
        raise UserError(f"--range: expected 0 to 180 degrees, found {options.range:g}")
    return FramingRequest(
        up=default_up if options.up == "auto" else parse_up(options.up) or default_up,
        view_deg=view,
        azimuth_range_deg=options.range,
        center_file=None if center is None else (center[0], center[1], center[2]),
        size_file=options.object_size,
    )


def check_out(options: ObjectOptions, source_file: Path) -> None:
    """Check the destination, and what the record will say, before the work starts.

    Raises:
        UserError: it holds something, and ``--overwrite`` is not given or it is no object folder;
            an option is a number that is not finite, the prompt is empty or no Unicode text, or
            the id is no plain file name.
    """
    from splatcomplete_data.atomic_folder import check_destination
    from splatcomplete_data.objects import PROPOSED_FILES, RECORD_FILE

    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if isinstance(value, float) and not math.isfinite(value):
            name = field.name.replace("_", "-")
            raise UserError(f"--{name}: expected a finite number, found {value:g}")
    require_prompt(options.prompt)
    if options.id is not None and not is_plain_name(options.id):
        raise UserError(f"--id: expected a plain file name, found {options.id!r}")
    check_destination(
        options.out or default_folder(source_file),
        marker=RECORD_FILE,
        spare=PROPOSED_FILES,
        overwrite=options.overwrite,
    )


def _prompt_from(source_file: Path) -> str:
    """Return the prompt of an object when ``--prompt`` is not given."""
    name = shown_name(source_file.stem).replace("_", " ")
    words = "".join(" " if has_controls(character) else character for character in name)
    return words.strip() or "an object"


def default_folder(source_file: Path) -> Path:
    """Return the object folder of a source when ``--out`` is not given."""
    return Path(f"{source_file.stem or 'object'}_object")


def recorded_options(options: ObjectOptions) -> dict[str, Any]:
    """Return the options that decide the result, as JSON values."""
    values = {field.name: getattr(options, field.name) for field in dataclasses.fields(options)}
    return {name: jsonio.to_json(v) for name, v in values.items() if name not in NOT_RECORDED}


def say(options: Any, *lines: str) -> None:
    """Print lines for a person: standard output, or standard error when that is for a machine."""
    stream = sys.stderr if getattr(options, "json", False) else sys.stdout
    for line in lines:
        stream.write(f"{shown_text(line)}\n")


@contextlib.contextmanager
def progress(title: str) -> Iterator[Report]:
    """Show a bar with an ETA on standard error; yield the callback that moves it."""
    with progress_bar(title, transient=True) as bar:
        task = bar.add_task(title, total=1)

        def report(done: int, total: int) -> None:
            bar.update(task, completed=done, total=max(total, 1))

        yield report


@contextlib.contextmanager
def stages(title: str) -> Iterator[StageCallback]:
    """Show the stage, a bar and an ETA on standard error; yield what says that a stage begins.

    The shares that callers give are rough, and so is the ETA. Nothing is shown where standard
    error is not a terminal.
    """
    progress = progress_bar(f"{title}: {{task.description}}", count=None, transient=True)
    progress.disable = not progress.console.is_terminal
    with progress as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda name, share: bar.update(task, description=name, completed=share)
