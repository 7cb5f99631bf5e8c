"""``splatcomplete-data convert``: splat files from one format to another."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gscomplete.errors import UserError
from splatcomplete_data.cli.common import say


@dataclass(frozen=True, kw_only=True)
class ConvertOptions:
    """Convert a splat file: .ply, .compressed.ply, .splat, .spz, .glb (KHR_gaussian_splatting).

    What the target cannot hold is named, and so are properties and comments beside the splats.

    Example: splatcomplete-data convert biker.spz biker.ply
    """

    source: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE")]
    """File to read."""
    target: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="TARGET")]
    """File to write; its name says the format."""
    overwrite: bool = False
    """Replace the target if it exists."""
    spz_version: Literal[3, 4] = 3
    """Version of SPZ files: 3 is read everywhere, 4 is smaller."""


def run(options: ConvertOptions) -> int:
    """Convert; return the exit code."""
    from splatcomplete_data.formats import format_of, read_any_splats, write_any_splats

    format_of(options.target)
    if options.target.exists() and not options.overwrite:
        raise UserError(f"{options.target}: it exists; replace it with --overwrite")
    found = read_any_splats(options.source)
    written = write_any_splats(options.target, found.splats, spz_version=options.spz_version)
    lost = (*found.left, *written)
    say(options, *found.notes)
    if lost:
        say(options, f"lost: {', '.join(lost)}")
    degree = found.splats.sh_degree
    say(options, f"written: {options.target} ({len(found.splats):,} splats, SH degree {degree})")
    return 0
