"""``--pick FILE``: boxes of `crop` and `scan` chosen on a page, until Ctrl-C."""

from __future__ import annotations

import shlex
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

from gscomplete.errors import UserError
from splatcomplete_data.cuts.box_page import PickedPoints, pick_boxes
from splatcomplete_data.cuts.boxes import BOXES_SUFFIX, CropBox


def check_options(path: Path, *, propose: bool) -> None:
    """Refuse what cannot be done: a file that --box would not read, or --propose at once.

    Raises:
        UserError: it is no file of boxes, its folder does not exist, or --propose is given.
    """
    if propose:
        raise UserError("--pick, --propose: expected one of them, found both")
    if path.suffix != BOXES_SUFFIX:
        raise UserError(f"--pick: expected a file NAME{BOXES_SUFFIX}, found {str(path)!r}")
    if not path.parent.is_dir():
        raise UserError(f"--pick: {path}: the folder does not exist")


def run_page(
    picked: PickedPoints,
    boxes: Sequence[CropBox],
    path: Path,
    command: str,
    file: Path,
) -> int:
    """Serve the page until it is interrupted; return the exit code.

    Args:
        picked: what to cut.
        boxes: to begin with.
        path: where they are saved.
        command: `crop` or `scan`.
        file: what the command reads.

    Raises:
        UserError: the page cannot be served.
    """
    line = f"splatcomplete-data {command} {shlex.quote(str(file))}"
    page = pick_boxes(picked, boxes, path, line, _print)
    try:
        at = f"http://{page.server.get_host()}:{page.server.get_port()}"
        _print(f"{at} (Ctrl-C ends it; from another machine, forward the port first)")
        threading.Event().wait()
    except KeyboardInterrupt:
        pass
    finally:
        page.server.stop()
    return 0


def _print(line: str) -> None:
    """Print a line at once, though the output is a pipe."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()
