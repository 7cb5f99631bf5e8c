"""``splatcomplete-data clean``: leave out what does not belong to the object."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from gscomplete.errors import UserError, naming
from splatcomplete_data.cli.common import say

if TYPE_CHECKING:
    from splatcomplete_data.clean.rules import Cleaned, Rule
    from splatcomplete_data.multiview.scene import Scene

_PICTURE = "clean.png"


@dataclass(frozen=True, kw_only=True)
class CleanOptions:
    """Remove floaters, haze, giant and needle splats, and stray islands from a splat file.

    Prints how many splats each rule removes, and draws the splats before and after and those
    removed. Kept records of a PLY are copied byte for byte; frame and harmonics are not changed.
    Without --out only the picture is written.

    Examples: splatcomplete-data clean scene.ply;
    splatcomplete-data clean scene.ply --out cleaned.ply --strength 0.7 --background
    """

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """Splat file in any format, or capture folder."""
    out: Path | None = None
    """Splat file to write, in any format; None = only draw and count."""
    strength: float = 0.5
    """0 removes only splats that cannot be drawn; 0.5 those that `gscomplete validate` warns of; 1
    all that an evenly covered surface does not have."""
    rules: tuple[Literal["floaters", "giants", "haze", "needles", "islands"], ...] = (
        *("floaters", "giants", "haze", "needles", "islands"),
    )
    """Rules to apply."""
    background: bool = False
    """Also remove planes that the object stands on or against (table, floor, wall), and all behind
    them."""
    up: str = "auto"
    """Axis that points up, X, Y, Z, -X, -Y or -Z, or a direction X,Y,Z, for --background and the
    picture; auto = as the capture's cameras say, else -Y."""
    picture: Path | None = None
    """Picture to write; None = clean.png in the current folder, or --out's name with .png."""
    overwrite: bool = False
    """Replace --out and the picture that is named, or beside --out, if they exist."""
    json: bool = False
    """Print only counts and file names, as JSON, on standard output."""


def run(options: CleanOptions) -> int:
    """Clean; return the exit code.

    Raises:
        UserError: the file cannot be read or written, or nothing is left.
    """
    from gscomplete.evaluate.pictures import require_own_picture, save_image
    from gscomplete.splats.formats.any_file import writable_format_of
    from gscomplete.views import parse_up
    from splatcomplete_data.clean.rules import clean_rows
    from splatcomplete_data.multiview.scene import read_scene

    path = options.picture or Path(_PICTURE)
    named = [] if options.picture is None else [options.picture]
    if options.out is not None:
        writable_format_of(options.out)
        path = options.picture or options.out.with_suffix(".png")
        named = [options.out, path]
    if not named:
        require_own_picture(path)
    for file in named:
        if file.exists() and not options.overwrite:
            raise UserError(f"{file}: it exists; replace it with --overwrite")
    scene = read_scene(options.file, None if options.up == "auto" else parse_up(options.up))
    rules: list[Rule] = [*options.rules]
    if options.background:
        rules.append("background")
    with naming(f"{options.file}: --background"):
        focus = scene.focus() if options.background else None
    with naming(options.file):
        cleaned = clean_rows(scene.file.splats, options.strength, rules, focus)
    lost = _write(options.out, scene, cleaned) if options.out is not None else ()
    save_image(_sheet(scene, cleaned), path)
    _report(options, scene, cleaned, lost, path)
    return 0


def _write(path: Path, scene: Scene, cleaned: Cleaned) -> tuple[str, ...]:
    """Write what stays; return what the format loses."""
    import torch

    from gscomplete.splats.formats.any_file import format_of, write_any_splats
    from splatcomplete_data.framing import y_up_turn
    from splatcomplete_data.multiview.crop import write_rows

    if format_of(path) == "ply":
        write_rows(path, scene.file, cleaned.keep)
        return ()
    kept = scene.file.splats.select(torch.from_numpy(cleaned.keep))
    return write_any_splats(path, kept, y_up=y_up_turn(scene.up_axis))


def _sheet(scene: Scene, cleaned: Cleaned) -> Any:
    """Draw before, after, and what went."""
    import torch

    from gscomplete.splats import usable_rows
    from splatcomplete_data.clean.picture import clean_sheet

    splats = scene.file.splats
    keep = torch.from_numpy(cleaned.keep)
    usable, _ = usable_rows(splats)
    kept = splats.select(keep)
    cameras = scene.picture_cameras([], kept)
    return clean_sheet(
        splats.select(usable), kept, splats.select(usable & ~keep), cameras, scene.near
    )


def _report(
    options: CleanOptions, scene: Scene, cleaned: Cleaned, lost: tuple[str, ...], picture: Path
) -> None:
    """Tell what went and what was written."""
    kept, total = int(cleaned.keep.sum()), len(cleaned.keep)
    say(options, *scene.notes, *scene.file.warnings, *cleaned.notes)
    for reason, count in cleaned.reasons.items():
        say(options, f"{reason}: {count:,} ({100 * count / total:.2f} %)")
    say(options, f"keeps {kept:,} of {total:,} splats; drawn: {picture}")
    if lost:
        say(options, f"lost: {', '.join(lost)}")
    if options.out is not None:
        say(options, f"written: {options.out}")
    if options.json:
        content = {
            "splats": total,
            "kept": kept,
            "removed": cleaned.reasons,
            "strength": options.strength,
            "notes": list(cleaned.notes),
            "picture": str(picture),
            "out": None if options.out is None else str(options.out),
        }
        sys.stdout.write(json.dumps(content) + "\n")
