"""Start a recipe from the command line: its options, its help, and errors without tracebacks."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import NoReturn, TypeVar

import tyro

from gscomplete.cli.guard import run_guarded

Options = TypeVar("Options")


def start(
    main: Callable[[Options], int | None], options: type[Options], description: str | None
) -> NoReturn:
    """Read the options, run, and exit.

    Args:
        main: the recipe; returns its exit code, None = 0.
        options: its options' dataclass.
        description: what ``--help`` says first: the module's own description.
    """
    chosen = tyro.cli(options, description=description)
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    name = spec.name.removesuffix(".__main__") if spec is not None else sys.argv[0]
    sys.exit(run_guarded(name, lambda: main(chosen) or 0, "the same command starts it again"))
