"""The ``splatcomplete-data`` command.

To add a subcommand: write ``commands/NAME.py`` with an option class and ``run(options) -> int``,
then add one line to ``_RUNNERS`` and one to ``Command``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import tyro

from gscomplete.command_line import let_threads_sleep, print_version, run_guarded

let_threads_sleep()  # the commands load PyTorch, and with it the OpenMP runtime
from splatcomplete_data.commands import convert, crop, dataset, depth, images, mesh, partial, scan
from splatcomplete_data.pictures import allow_large_pictures

_RUNNERS: dict[type, Callable[[Any], int]] = {
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

_LISTS = ("--box", "--cut", "--only")

Command = (
    Annotated[convert.ConvertOptions, tyro.conf.subcommand("convert")]
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
    allow_large_pictures()
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if arguments == ["--version"]:
        return print_version("splatcomplete-data")
    options = tyro.cli(
        Command,
        prog="splatcomplete-data",
        description="Turn photos, depth, scans and meshes into partial splat objects.",
        args=gathered(arguments),
        config=(tyro.conf.OmitArgPrefixes,),
    )
    return run_guarded(
        "splatcomplete-data",
        lambda: _RUNNERS[type(options)](options),
        "nothing half-written is left; the same command starts again",
    )


def gathered(arguments: Sequence[str]) -> list[str]:
    """Bring the values of a repeated list option together behind its first place.

    ``--box A --box B`` says the same as ``--box A B``; argparse alone would forget A.
    """
    result: list[str] = []
    ends: dict[str, int] = {}  # where in the result the next value of an option goes
    current: str | None = None
    for word in arguments:
        option, equals, value = word.partition("=")
        if option in _LISTS:
            current = option
            if option not in ends:
                result.append(option)
                ends[option] = len(result)
            if not equals:
                continue
            word = value
        elif word.startswith("--"):
            current = None
        if current is None:
            result.append(word)
            continue
        place = ends[current]
        result.insert(place, word)
        ends = {name: end + (end >= place) for name, end in ends.items()}
    return result


if __name__ == "__main__":
    sys.exit(main())
