"""``splatcomplete-data convert``: splat files from one format to another."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from gscomplete.errors import UserError
from splatcomplete_data.cli.common import say

if TYPE_CHECKING:
    from gscomplete.folders.drawable import Drawable
    from gscomplete.splats import Splats
    from gscomplete.views import ObjectFrame, UpAxis


@dataclass(frozen=True, kw_only=True)
class ConvertOptions:
    """Convert a splat file to another format, or to a page that shows it.

    Reads .ply, .compressed.ply, .splat, .spz (1 to 4), .glb (KHR_gaussian_splatting), .sog (or the
    folder of its meta.json) and .ksplat. Writes all of these but .ksplat, USD (.usd, .usda, .usdc:
    ParticleField3DGaussianSplat), and .html, which opens without a network. Prints what the target
    cannot hold, such as additional properties and comments, and how axes were turned.

    Examples: splatcomplete-data convert biker.spz biker.ply;
    splatcomplete-data convert biker.ply biker.html --up -Y
    """

    source: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE")]
    """File to read; a run folder stands for its completed.ply, an object folder for its
    partial.ply."""
    target: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TARGET")]
    """File to write; its suffix selects the format."""
    overwrite: bool = False
    """Replace the target if it exists."""
    spz_version: Literal[3, 4] = 3
    """Version of SPZ files: 3 is read everywhere, 4 is smaller."""
    up: str = "auto"
    """For .html and the formats that are y up (.glb, .usd*, .spz): axis of the splats that points
    up, X, Y, Z, -X, -Y or -Z, or a direction X,Y,Z; auto = as the object or run folder of SOURCE
    says, if it is in one, else -Y."""
    most_splats: int = 500_000
    """For .html: a page with more splats holds an even subset, enlarged to match. A splat takes 23
    bytes."""


def run(options: ConvertOptions) -> int:
    """Convert; return the exit code."""
    from gscomplete.splats.formats.any_file import (
        axes_note,
        read_any_splats,
        writable_format_of,
        write_any_splats,
    )
    from splatcomplete_data.framing import y_up_turn

    is_page = options.target.suffix.lower() == ".html"
    if not is_page:
        writable_format_of(options.target)
    _require_heeded(options, is_page=is_page)
    if options.target.exists() and not options.overwrite:
        raise UserError(f"{options.target}: it exists; replace it with --overwrite")
    source = _source_of(options.source)
    found = read_any_splats(source.file)
    say(options, *found.notes)
    if is_page:
        written = _write_page(options, found.splats, source.frame)
    else:
        y_up = None
        if axes_note(options.target) is not None:
            up, origin = _up_of(options, source)
            y_up = y_up_turn(up)
            say(options, f"{axes_note(options.target, y_up)} ({up} is up, {origin})")
        written = write_any_splats(
            options.target, found.splats, spz_version=options.spz_version, y_up=y_up
        )
    lost = (*found.left, *written)
    if lost:
        say(options, f"lost: {', '.join(lost)}")
    degree = found.splats.sh_degree
    say(options, f"written: {options.target} ({len(found.splats):,} splats, SH degree {degree})")
    return 0


def _require_heeded(options: ConvertOptions, *, is_page: bool) -> None:
    """Refuse options that the target's format has no use for.

    Raises:
        UserError: there is one.
    """
    from gscomplete.splats.formats.any_file import axes_note

    defaults = {field.name: field.default for field in dataclasses.fields(ConvertOptions)}
    suffix = options.target.suffix.lower()
    heeded = {
        "up": is_page or axes_note(options.target) is not None,
        "spz_version": suffix == ".spz",
        "most_splats": is_page,
    }
    for name, is_heeded in heeded.items():
        value = getattr(options, name)
        if value != defaults[name] and not is_heeded:
            flag = name.replace("_", "-")
            raise UserError(f"--{flag} {value}: has no effect on {suffix} files; leave it out")


def _source_of(path: Path) -> Drawable:
    """Return the file that a path means, with what its folder says of it.

    Raises:
        UserError: it is a folder of another kind.
    """
    from gscomplete.folders.drawable import Drawable, drawable_of
    from gscomplete.splats.formats.sog import META_FILE

    return Drawable(path) if (path / META_FILE).is_file() else drawable_of(path)


def _up_of(options: ConvertOptions, source: Drawable) -> tuple[UpAxis, str]:
    """Return what points up in the source, and what says so.

    Raises:
        UserError: ``--up`` is no axis.
    """
    from gscomplete.util.file_names import OUTPUT_FILE
    from gscomplete.views import parse_up
    from splatcomplete_data.framing import SPLAT_FILE_UP

    up = None if options.up == "auto" else parse_up(options.up)
    if up is not None:
        return up, "by --up"
    if source.frame is not None:
        is_result = source.file.name == OUTPUT_FILE
        return source.frame.up, "by its run" if is_result else "by its object folder"
    return SPLAT_FILE_UP, "assumed; --up gives another"


def _write_page(
    options: ConvertOptions, splats: Splats, known: ObjectFrame | None
) -> tuple[str, ...]:
    """Write the page; return what is lost.

    Raises:
        UserError: an option is out of range, or nothing can be drawn.
    """
    from gscomplete.report.splat_page import write_splat_page
    from gscomplete.splats import usable_rows
    from gscomplete.views import ObjectFrame, parse_up
    from splatcomplete_data.framing import SPLAT_FILE_UP, UP_ASSUMED

    if not 100 <= options.most_splats <= 5_000_000:
        raise UserError(f"--most-splats: expected 100 to 5,000,000, found {options.most_splats}")
    usable, _ = usable_rows(splats)
    if not bool(usable.any()):
        raise UserError(f"{options.source}: expected splats that can be drawn, found none")
    up = None if options.up == "auto" else parse_up(options.up)
    if up is not None:
        frame = ObjectFrame.without_floaters(splats.select(usable), up)
    elif known is not None:
        frame = known
    else:
        say(options, UP_ASSUMED)
        frame = ObjectFrame.without_floaters(splats.select(usable), SPLAT_FILE_UP)
    title = options.source.name
    return write_splat_page(
        options.target, splats.select(usable), frame, title, options.most_splats
    )
