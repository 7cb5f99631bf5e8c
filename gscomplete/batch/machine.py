"""How many workers a machine can run: cores, memory, GPUs.

Conventions
-----------
* Threads of all workers together are at most the cores that this process may use.
* Available memory is what the system reports as usable without swapping, within the limit of the
  control group (cgroup) that the process runs in.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from gscomplete.errors import UserError

GIB = 2**30


@dataclass(frozen=True, slots=True)
class WorkerPlan:
    """Workers of one machine."""

    count: int
    threads: int
    """Of each worker."""
    memory_bytes: int
    """Must be free before a worker starts; also a CPU worker's limit; 0 = no bound."""
    gpus: tuple[str, ...] = ()
    """One for each worker in turn; none = the CPU."""

    def environment(self, number: int = 0) -> dict[str, str]:
        """Return a worker's environment variables, which must be set before it starts."""
        threads = str(self.threads)
        values = {
            "OMP_NUM_THREADS": threads,
            "MKL_NUM_THREADS": threads,
            "NUMBA_NUM_THREADS": threads,
        }
        if self.gpus:
            values["CUDA_VISIBLE_DEVICES"] = self.gpus[number % len(self.gpus)]
        return values


def plan_workers(
    items: int,
    *,
    memory_bytes: int,
    count: int | None = None,
    threads: int | None = None,
    gpus: tuple[str, ...] = (),
) -> WorkerPlan:
    """Choose workers for this machine.

    Args:
        items: number of objects to do.
        memory_bytes: what a worker needs, positive.
        count: number of workers; None = one per GPU, or without GPUs one per core, as far as the
            memory suffices.
        threads: of each worker; None = the cores divided by the number of workers.
        gpus: names of the GPUs to use.

    Raises:
        UserError: the machine cannot run what was asked for.
    """
    cores = usable_cores()
    free = available_bytes()
    fitting = cores if free is None else free // memory_bytes
    if fitting < (count or 1):
        assert free is not None
        raise UserError(
            f"--workers {count or 1}: expected {memory_bytes / GIB:.1f} GiB of memory for each "
            f"worker (--memory), found {free / GIB:.1f} GiB free"
        )
    if count is None:
        wanted = len(gpus) or max(1, cores // (threads or 1))
        count = max(1, min(wanted, fitting, items))
    return WorkerPlan(count, threads or max(1, cores // count), memory_bytes, gpus)


def usable_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def available_bytes(proc: Path = Path("/proc"), group: Path = Path("/sys/fs/cgroup")) -> int | None:
    """Return how many bytes of memory are available; None where the system does not say.

    Args:
        proc: folder of the system's figures (``/proc``).
        group: folder of the control group's limits.
    """
    found = []
    try:
        for line in (proc / "meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                found.append(int(line.split()[1]) * 1024)
    except (OSError, ValueError):
        pass
    try:
        most = (group / "memory.max").read_text().strip()
        if most != "max":
            used = int((group / "memory.current").read_text())
            cached = _cached_bytes(group / "memory.stat")
            found.append(max(0, int(most) - used + cached))
    except (OSError, ValueError):
        pass
    return min(found, default=None)


def _cached_bytes(path: Path) -> int:
    """Return how much of a control group's memory is file cache, which can be dropped."""
    for line in path.read_text().splitlines():
        if line.startswith("inactive_file "):
            return int(line.split()[1])
    return 0


def visible_gpus(proc: Path = Path("/proc/driver/nvidia/gpus")) -> tuple[str, ...]:
    """Return the names of the NVIDIA GPUs that CUDA would use, without loading PyTorch."""
    chosen = os.environ.get("CUDA_VISIBLE_DEVICES")
    if chosen is not None:
        return tuple(name for name in chosen.split(",") if name and name != "-1")
    try:
        return tuple(str(number) for number, _ in enumerate(proc.iterdir()))
    except OSError:
        return ()
