"""The ``gscomplete`` command."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import tyro

import gscomplete
from gscomplete.commands import complete, render, validate
from gscomplete.errors import UserError

DEBUG_VARIABLE = "GSCOMPLETE_DEBUG"
"""Set to anything, an unexpected error ends in its traceback."""

_RUNNERS: dict[type, Callable[[Any], int]] = {
    complete.CompleteOptions: complete.run,
    render.RenderOptions: render.run,
    validate.ValidateOptions: validate.run,
}

Command = (
    Annotated[complete.CompleteOptions, tyro.conf.subcommand("complete")]
    | Annotated[render.RenderOptions, tyro.conf.subcommand("render")]
    | Annotated[validate.ValidateOptions, tyro.conf.subcommand("validate")]
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    # Threads that wait must sleep: PyTorch and Numba each keep a pool, and a pool that spins while
    # the other works halves the speed of both. Read by the OpenMP runtime when it loads.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ.setdefault("GOMP_SPINCOUNT", "0")
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if arguments == ["--version"]:
        print(f"gscomplete {gscomplete.__version__}")
        return 0
    options = tyro.cli(
        Command,
        prog="gscomplete",
        description="Complete partial 3D objects made of Gaussian splats.",
        args=arguments,
    )
    try:
        return _RUNNERS[type(options)](options)
    except UserError as error:
        print(f"gscomplete: error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print(
            "gscomplete: interrupted; --resume continues from the last checkpoint", file=sys.stderr
        )
        return 130
    except BrokenPipeError:
        return 141  # the reader of our output is gone, as with ``| head``
    except MemoryError:
        print("gscomplete: error: out of memory", file=sys.stderr)
        return 4
    except Exception as error:
        if os.environ.get(DEBUG_VARIABLE):
            raise
        print(
            f"gscomplete: internal error: {type(error).__name__}: {error}\n"
            f"Please report it; {DEBUG_VARIABLE}=1 shows where it happened.",
            file=sys.stderr,
        )
        return 70


if __name__ == "__main__":
    sys.exit(main())
