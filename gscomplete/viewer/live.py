"""Follow an unfinished run: show the new splats of each checkpoint as it is written.

Conventions
-----------
* Checkpoints hold new splats in the object frame. A run writes ``completed.ply`` first, then
  metrics and alternatives, and last ``run.json``, which ends the following.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gscomplete.errors import UserError
from gscomplete.fitting.checkpoint import FILE_NAME, load_checkpoint
from gscomplete.fitting.parameters import splats_of_state
from gscomplete.fitting.step_loop import CHECKPOINTS
from gscomplete.folders import read_run_folder
from gscomplete.splats import Splats

_POLL_S = 1.0


@dataclass(frozen=True, slots=True)
class Progress:
    """New splats of a run at one of its steps."""

    step: int
    splats: Splats
    """Object frame."""


def newest(folder: Path) -> Progress | None:
    """Return the new splats of a run folder's newest checkpoint; None = there is no checkpoint yet.

    Raises:
        UserError: it cannot be read.
    """
    state = load_checkpoint(folder / CHECKPOINTS)
    if state is None:
        return None
    try:
        return Progress(int(state["step"]), splats_of_state(state))
    except (KeyError, ValueError) as error:
        path = folder / CHECKPOINTS / FILE_NAME
        raise UserError(f"{path}: expected the splats of a completion ({error})") from error


def follow(
    folder: Path,
    on_progress: Callable[[Progress], None],
    on_result: Callable[[bool], None],
    stop: threading.Event,
    poll_s: float = _POLL_S,
) -> None:
    """Report every new checkpoint, and the result, until the run has finished or ``stop`` is set.

    Args:
        folder: the run folder.
        on_progress: called with the new splats of each newest checkpoint.
        on_result: called with False when ``completed.ply`` appears, and with True when the run has
            finished.
        stop: set by the caller to end the following.
        poll_s: seconds between two looks at the folder.
    """
    path, seen, has_result = folder / CHECKPOINTS / FILE_NAME, 0, False
    while not stop.is_set():
        # a file that is being replaced, or a folder that is being made anew, is read next time
        with contextlib.suppress(UserError, OSError):
            run = read_run_folder(folder)
            if run.output.is_file():
                is_finished = run.content.get("status") != "running"
                if is_finished or not has_result:
                    on_result(is_finished)
                has_result = True
                if is_finished:
                    return
                stop.wait(poll_s)
                continue
            now = path.stat().st_mtime_ns
            if now != seen:
                found = newest(folder)
                if found is not None:
                    seen = now
                    on_progress(found)
        stop.wait(poll_s)
