"""Commands as users give them, in the process of the tests, which has loaded PyTorch already."""

from __future__ import annotations

import contextlib
import importlib
import io
from dataclasses import dataclass


@dataclass(frozen=True)
class Told:
    """What a command ended with and printed."""

    returncode: int
    stdout: str
    stderr: str


def run_here(*arguments: object, package: str = "gscomplete") -> Told:
    """Run a command of a package; return what it printed and its exit code."""
    main = importlib.import_module(f"{package}.cli").main
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(list(map(str, arguments)))
        except SystemExit as end:  # of the reader of options
            code = end.code
    return Told(code, out.getvalue(), err.getvalue())
