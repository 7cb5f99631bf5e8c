"""Commands as users give them: here, where all is loaded, or in a process of their own."""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
SAMPLE = REPOSITORY / "recipes/demo/partial.ply"
"""The mug, cut through, that ``make demo`` completes."""


PATIENCE_S = 600
"""What hangs is ended after this; a busy machine takes minutes where an idle one takes seconds."""


@dataclass(frozen=True)
class Told:
    """What a command ended with and printed."""

    returncode: int
    stdout: str
    stderr: str


def run_here(*arguments: object, package: str = "gscomplete") -> Told:
    """Run a command in this process: what it prints and returns, without loading PyTorch again."""
    main = importlib.import_module(f"{package}.cli").main
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(list(map(str, arguments)))
        except SystemExit as end:  # of the reader of options
            code = end.code
    return Told(code, out.getvalue(), err.getvalue())


def start_alone(*arguments: object, package: str = "gscomplete") -> subprocess.Popen:
    """Start a command in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", f"{package}.cli", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
    )


def run_alone(*arguments: object, package: str = "gscomplete") -> Told:
    """Run a command in a process of its own."""
    with start_alone(*arguments, package=package) as child:
        try:
            stdout, stderr = child.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            child.kill()
            raise
    return Told(child.returncode, stdout, stderr)
