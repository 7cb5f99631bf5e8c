"""Where a run's time and memory go: named stages, which may lie within each other.

Conventions
-----------
* A stage's seconds exclude those of the stages within it.
* Processor time is that of all threads of the process; memory is the largest resident set of the
  process up to the stage's end, so the stage at which it rises is the one that needs it.
* Nothing is recorded outside :func:`profiled`; a stage then costs only the reading of a variable.
"""

from __future__ import annotations

import contextlib
import resource
import sys
import time
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field


@dataclass(slots=True)
class StageCost:
    """Time and memory of a stage, summed over all times that it was entered."""

    wall_s: float = 0.0
    cpu_s: float = 0.0
    times: int = 0
    peak_bytes: int = 0


@dataclass(slots=True)
class Profile:
    """Stages in the order in which they were first entered."""

    costs: dict[str, StageCost] = field(default_factory=dict)
    _open: list[str] = field(default_factory=list)
    _since: tuple[float, float] = (0.0, 0.0)

    def enter(self, name: str) -> None:
        """Begin a stage; the one around it waits."""
        self._settle()
        self.costs.setdefault(name, StageCost()).times += 1
        self._open.append(name)

    def leave(self) -> None:
        """End the innermost stage."""
        self._settle()
        self._open.pop()

    def _settle(self) -> None:
        """Add the time since the last change to the innermost stage."""
        now = time.perf_counter(), time.process_time()
        if self._open:
            cost = self.costs[self._open[-1]]
            cost.wall_s += now[0] - self._since[0]
            cost.cpu_s += now[1] - self._since[1]
            cost.peak_bytes = peak_resident_bytes()
        self._since = now

    def to_json(self) -> dict[str, dict[str, float]]:
        """Return the costs by stage as JSON values."""
        return {
            name: {
                "wall_s": round(cost.wall_s, 4),
                "cpu_s": round(cost.cpu_s, 4),
                "times": cost.times,
                "peak_bytes": cost.peak_bytes,
            }
            for name, cost in self.costs.items()
        }

    def lines(self) -> list[str]:
        """Return a table for people, with a line for the sum."""
        width = max([len(name) for name in self.costs] + [5])
        found = [f"{'stage':{width}} {'wall s':>8} {'cpu s':>8} {'times':>6} {'peak MiB':>9}"]
        for name, cost in self.costs.items():
            found.append(
                f"{name:{width}} {cost.wall_s:8.3f} {cost.cpu_s:8.3f} {cost.times:6}"
                f" {cost.peak_bytes / 2**20:9.0f}"
            )
        wall, cpu = (sum(getattr(c, key) for c in self.costs.values()) for key in _SUMMED)
        return [*found, f"{'sum':{width}} {wall:8.3f} {cpu:8.3f}"]


_SUMMED = ("wall_s", "cpu_s")
_PROFILE: ContextVar[Profile | None] = ContextVar("profile", default=None)


@contextlib.contextmanager
def profiled() -> Iterator[Profile]:
    """Record the stages of everything that runs within the block."""
    found = Profile()
    token = _PROFILE.set(found)
    try:
        yield found
    finally:
        _PROFILE.reset(token)


def current_profile() -> Profile | None:
    """Return the profile that is being recorded, if any."""
    return _PROFILE.get()


@contextlib.contextmanager
def stage(name: str) -> Iterator[None]:
    """Attribute what runs within the block to a stage, if a profile is being recorded.

    Args:
        name: the stage's name in the table.
    """
    current = _PROFILE.get()
    if current is None:
        yield
        return
    current.enter(name)
    try:
        yield
    finally:
        current.leave()


def peak_resident_bytes() -> int:
    """Return the largest resident set of this process so far."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
