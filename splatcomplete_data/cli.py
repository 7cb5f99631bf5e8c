"""The ``splatcomplete-data`` command.

To add a subcommand: write ``commands/NAME.py`` with an option class and ``run(options) -> int``,
then add one line to ``_RUNNERS`` and one to ``Command``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import tyro

import gscomplete
from gscomplete.command_line import let_threads_sleep, run_guarded
from splatcomplete_data.commands import convert, crop, dataset, depth, images, mesh, partial, scan

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
    let_threads_sleep()
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if arguments == ["--version"]:
        sys.stdout.write(f"splatcomplete-data {gscomplete.__version__}\n")
        return 0
    options = tyro.cli(
        Command,
        prog="splatcomplete-data",
        description="Turn photos, depth, scans and meshes into partial splat objects.",
        args=arguments,
        config=(tyro.conf.OmitArgPrefixes,),
    )
    return run_guarded(
        "splatcomplete-data",
        lambda: _RUNNERS[type(options)](options),
        "nothing half-written is left; the same command starts again",
    )


if __name__ == "__main__":
    sys.exit(main())
