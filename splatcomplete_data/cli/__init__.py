"""The ``splatcomplete-data`` command: its subcommands, their options, and the guard about them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    from gscomplete.cli.guard import run_guarded

    def load_and_run() -> int:
        from splatcomplete_data.cli import program

        return program.main(arguments)

    return run_guarded("splatcomplete-data", load_and_run, "nothing was done")


def run_process() -> NoReturn:
    """Run the command line of this process, and end it."""
    from gscomplete.cli import guard

    guard.run_process(main)
