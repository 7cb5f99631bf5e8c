"""The ``gscomplete`` command."""

from __future__ import annotations

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
from gscomplete.cli import batch, complete, evaluate, render, report, validate, view, weights
from gscomplete.cli.complete_options import CompleteOptions

_RUNNERS: dict[type, Callable[[Any], int]] = {
    batch.BatchOptions: batch.run,
    CompleteOptions: complete.run,
    evaluate.EvaluateOptions: evaluate.run,
    render.RenderOptions: render.run,
    report.ReportOptions: report.run,
    validate.ValidateOptions: validate.run,
    view.ViewOptions: view.run,
    weights.WeightsOptions: weights.run,
}

_GOES_ON: dict[type, str] = {
    batch.BatchOptions: "the same command continues with the unfinished objects"
}
"""What to tell after Ctrl-C where the same command does not start again from the beginning."""

Command = (
    Annotated[batch.BatchOptions, tyro.conf.subcommand("batch")]
    | Annotated[CompleteOptions, tyro.conf.subcommand("complete")]
    | Annotated[evaluate.EvaluateOptions, tyro.conf.subcommand("evaluate")]
    | Annotated[render.RenderOptions, tyro.conf.subcommand("render")]
    | Annotated[report.ReportOptions, tyro.conf.subcommand("report")]
    | Annotated[validate.ValidateOptions, tyro.conf.subcommand("validate")]
    | Annotated[view.ViewOptions, tyro.conf.subcommand("view")]
    | Annotated[weights.WeightsOptions, tyro.conf.subcommand("weights")]
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if arguments == ["--version"]:
        return print_version("gscomplete")
    arguments = with_new_names(arguments, {"--size": "--object-size"})
    options = read_options(
        Command,
        with_signs_joined(arguments),
        prog="gscomplete",
        description="Complete partial 3D objects made of Gaussian splats.",
    )
    keep_freed_memory()
    return run_guarded(
        "gscomplete",
        lambda: _RUNNERS[type(options)](options),
        _GOES_ON.get(type(options), "the same command starts again"),
    )
