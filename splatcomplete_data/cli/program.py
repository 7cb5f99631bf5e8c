"""The ``splatcomplete-data`` command.

To add a subcommand: write ``cli/NAME.py`` with an option class and ``run(options) -> int``,
then add one line to ``_RUNNERS`` and one to ``Command``.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import tyro

from gscomplete.cli.guard import (
    keep_freed_memory,
    let_threads_sleep,
    print_version,
    read_options,
    run_guarded,
)
from gscomplete.util.parse import with_new_names, with_signs_joined

let_threads_sleep()  # the commands load PyTorch, and with it the OpenMP runtime
from splatcomplete_data.cli import clean, convert, crop, dataset, depth, images, mesh, partial, scan

_RUNNERS: dict[type, Callable[[Any], int]] = {
    clean.CleanOptions: clean.run,
    convert.ConvertOptions: convert.run,
    crop.CropOptions: crop.run,
    dataset.BuildOptions: dataset.run_build,
    dataset.ListOptions: dataset.run_list,
    dataset.StatsOptions: dataset.run_stats,
    dataset.ValidateOptions: dataset.run_validate,
    depth.DepthOptions: depth.run,
    images.ImagesOptions: images.run,
    mesh.MeshOptions: mesh.run,
    partial.PartialOptions: partial.run,
    scan.ScanOptions: scan.run,
}

_RENAMED = {"--size-whole": "--object-size", "--size": "--splat-size"}
"""Old names of options, which are understood for one version."""

_LISTS = ("--box", "--cut", "--only", "--rules")

Command = (
    Annotated[clean.CleanOptions, tyro.conf.subcommand("clean")]
    | Annotated[convert.ConvertOptions, tyro.conf.subcommand("convert")]
    | Annotated[crop.CropOptions, tyro.conf.subcommand("crop")]
    | Annotated[dataset.BuildOptions, tyro.conf.subcommand("build")]
    | Annotated[dataset.ListOptions, tyro.conf.subcommand("list")]
    | Annotated[dataset.StatsOptions, tyro.conf.subcommand("stats")]
    | Annotated[dataset.ValidateOptions, tyro.conf.subcommand("validate")]
    | Annotated[depth.DepthOptions, tyro.conf.subcommand("depth")]
    | Annotated[images.ImagesOptions, tyro.conf.subcommand("images")]
    | Annotated[mesh.MeshOptions, tyro.conf.subcommand("mesh")]
    | Annotated[partial.PartialOptions, tyro.conf.subcommand("partial")]
    | Annotated[scan.ScanOptions, tyro.conf.subcommand("scan")]
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if arguments == ["--version"]:
        return print_version("splatcomplete-data")
    arguments = with_signs_joined(with_new_names(arguments, _RENAMED))
    try:
        options = read_options(
            Command,
            gathered(arguments),
            prog="splatcomplete-data",
            description="Turn photos, depth, scans and meshes into partial splat objects.",
            config=(tyro.conf.OmitArgPrefixes,),
        )
    except SystemExit as refusal:
        hint = greedy_hint(arguments) if refusal.code else None
        if hint is not None:
            sys.stderr.write(f"splatcomplete-data: {hint}\n")
        raise
    keep_freed_memory()
    return run_guarded(
        "splatcomplete-data",
        lambda: _run(options),
        "no half-written files are left; the same command starts again",
    )


def _run(options: Any) -> int:
    """Run a command; return its exit code."""
    from splatcomplete_data.pictures import allow_large_pictures

    allow_large_pictures()
    return _RUNNERS[type(options)](options)


def gathered(arguments: Sequence[str]) -> list[str]:
    """Bring the values of a repeated list option together behind its first place.

    ``--box A --box B`` means the same as ``--box A B``; argparse alone would drop A. Words after
    ``--box=A`` are not its values, so they are moved in front of the lists, which would take them.
    """
    result: list[str] = []
    ends: dict[str, int] = {}  # where in the result the next value of an option goes
    starts: list[int] = []  # where in the result the lists' names stand
    current: str | None = None
    is_closed = False  # the last option was ``--box=A``

    def insert(place: int, word: str) -> None:
        nonlocal ends, starts
        result.insert(place, word)
        ends = {name: end + (end >= place) for name, end in ends.items()}
        starts = [start + (start >= place) for start in starts]

    for word in arguments:
        option, equals, value = word.partition("=")
        if option in _LISTS:
            current, is_closed = option, bool(equals)
            if option not in ends:
                starts.append(len(result))
                result.append(option)
                ends[option] = len(result)
            if equals:
                insert(ends[option], value)
        elif word.startswith("--"):
            current, is_closed = None, False
            result.append(word)
        elif is_closed:
            insert(min(starts), word)
        elif current is not None:
            insert(ends[current], word)
        else:
            result.append(word)
    return result


def greedy_hint(arguments: Sequence[str]) -> str | None:
    """Say what a list option has taken, where the command line may lack a word because of that."""
    words = gathered(arguments)
    for option in _LISTS:
        place = words.index(option) + 1 if option in words else len(words)
        values = list(itertools.takewhile(lambda word: not word.startswith("--"), words[place:]))
        if len(values) > 1:
            return (
                f"{option} takes all arguments after it: {' '.join(values)}; if one of them is the "
                f"file, put it before {option}"
            )
    return None
