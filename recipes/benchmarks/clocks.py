"""Which clock a benchmark reads."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Literal

from gscomplete.errors import UserError

Clock = Literal["wall", "cpu"]
"""``wall``: what a user waits; needs a quiet machine. ``cpu``: processor time of the process, which
other jobs hardly change; for one thread only, as threads would add up."""


def clock_reader(clock: Clock, threads: int) -> Callable[[], float]:
    """Return the function that reads the clock, in seconds.

    Raises:
        UserError: processor time was asked for with several threads.
    """
    if clock == "wall":
        return time.perf_counter
    if threads != 1:
        raise UserError(f"--clock cpu: expected --threads 1, found {threads}")
    return time.process_time
