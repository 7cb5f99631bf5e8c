"""Compiled kernels: how and where they are compiled, and tasks shared out among threads.

Conventions
-----------
* Work that is shared out must release the interpreter lock where it matters (system calls, numpy,
  kernels with ``nogil``), and touch nothing that another task touches: results do not depend on
  threads.
* Loops that could use ``prange`` are instead plain kernels over a range of tasks: Numba compiles
  those in half the time, and they run as fast.
* The calling thread does tasks too, and never waits for a helper thread that has none.
* Helpers are daemons: an idle one does not keep the process alive.
* Two thirds of the time to compile hold the interpreter lock, so threads cannot share it. On a
  first run a forked process compiles some kernels, and this process loads them from the cache on
  the disk. Results do not depend on which process compiles a kernel, and neither waits for the
  other.
"""

from __future__ import annotations

import contextlib
import importlib
import itertools
import os
import queue
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numba
from numba.core import event, sigutils

from gscomplete.util.stages import current_profile

KERNEL: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
}
"""Numba options of functions that Python calls."""

HELPER: dict[str, Any] = {
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "no_cpython_wrapper": True,
}
"""Numba options of functions that only kernels call. Without wrappers for Python, and not cached on
the disk, they compile in two thirds of the time."""

_RUNS_PER_THREAD = 8
"""Runs per thread that a kernel's tasks are cut into, so that other threads can take over the rest
from one that is held up."""


class _Job:
    """Tasks 0 to count - 1, taken one after another by whichever thread is free."""

    def __init__(self, work: Callable[[int], None], count: int) -> None:
        self._work = work
        self._numbers = itertools.count()
        self._count = count
        self._left = count
        self._lock = threading.Lock()
        self._finished = threading.Event()
        self.failures: list[tuple[int, BaseException]] = []

    def take_tasks(self) -> None:
        """Do tasks until none is left; after a failure, take the rest without doing them."""
        while (number := next(self._numbers)) < self._count:
            try:
                if not self.failures:
                    self._work(number)
            except BaseException as error:
                self.failures.append((number, error))
            with self._lock:
                self._left -= 1
                if self._left == 0:
                    self._finished.set()

    def wait(self) -> None:
        """Wait for the tasks that others took."""
        self._finished.wait()


class _Helpers:
    """The threads beside the calling one, started when they are first needed."""

    def __init__(self) -> None:
        self._jobs: queue.SimpleQueue[_Job] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._started = 0

    def offer(self, job: _Job, helpers: int) -> None:
        """Let up to ``helpers`` threads take tasks of a job."""
        with self._lock:
            while self._started < helpers:
                threading.Thread(target=self._serve, daemon=True).start()
                self._started += 1
        for _ in range(helpers):
            self._jobs.put(job)

    def _serve(self) -> None:
        while True:
            self._jobs.get().take_tasks()


_helpers = _Helpers()


def _forget_helpers() -> None:
    """Drop the helpers in a forked process, which has none of its parent's threads."""
    global _helpers
    _helpers = _Helpers()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_helpers)


def share_out(work: Callable[[int], None], count: int, threads: int) -> None:
    """Call ``work`` with 0 to ``count`` - 1, in up to ``threads`` threads.

    Args:
        work: does the task of a number.
        count: number of tasks.
        threads: most threads, with the calling one.

    Raises:
        Exception: what ``work`` raised for the lowest number that failed; other tasks may be left
            undone.
    """
    job = _Job(work, count)
    helpers = min(threads, count) - 1
    if helpers > 0:
        _helpers.offer(job, helpers)
    job.take_tasks()
    if helpers > 0:
        job.wait()
    if job.failures:
        raise min(job.failures, key=lambda failure: failure[0])[1]


def run_kernel(kernel: Callable[..., None], count: int, grain: int, *arguments: Any) -> None:
    """Call ``kernel(first, last, *arguments)`` for runs of tasks that together are all of them.

    Args:
        kernel: a ``nogil`` kernel that does the tasks from ``first`` up to ``last``.
        count: number of tasks.
        grain: fewest tasks for which handing work to another thread saves time.
        arguments: what the kernel is given besides.
    """
    if not getattr(kernel, "overloads", True):
        kernel(0, 0, *arguments)  # compiles in this thread, whose profile counts it
    threads = numba.get_num_threads() if count > grain else 1
    runs = min(-(-count // grain), threads * _RUNS_PER_THREAD) if threads > 1 else 1
    if runs <= 1:
        kernel(0, count, *arguments)
        return

    def do_run(k: int) -> None:
        kernel(count * k // runs, count * (k + 1) // runs, *arguments)

    share_out(do_run, runs, threads)


class _Compilations(event.Listener):
    """Attributes compiling to a stage of the profile, and calls ``tell`` at the first kernel."""

    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell = tell
        self._depth = 0

    def on_start(self, event: event.Event) -> None:
        """Begin to compile a kernel, or, nested within that, a function that it calls."""
        self._depth += 1
        if self._depth > 1:
            return
        self._tell()
        self._tell = lambda: None
        profile = current_profile()
        if profile is not None:
            profile.enter("compile")

    def on_end(self, event: event.Event) -> None:
        """End what was begun last."""
        self._depth -= 1
        profile = current_profile()
        if self._depth == 0 and profile is not None:
            profile.leave()


@contextlib.contextmanager
def compilations_told(tell: Callable[[], None]) -> Iterator[None]:
    """Call ``tell`` before the first kernel that is compiled, and profile compiling as a stage.

    Loading a kernel from the cache on the disk does not count as compiling.
    """
    with event.install_listener("numba:compile", _Compilations(tell)):
        yield


class KernelTypes(NamedTuple):
    """A kernel and the types that it is called with."""

    module: str
    name: str
    types: str
    """Numba's notation: ``(i8, f4[:, ::1])``."""

    @property
    def kernel(self) -> Any:
        """The kernel itself."""
        return getattr(importlib.import_module(self.module), self.name)


def compile_beside(kernels: Sequence[KernelTypes]) -> int | None:
    """Fork a process that compiles kernels, unless the disk keeps them already.

    To be called before threads are at work.

    Args:
        kernels: what to compile, what is needed first coming first.

    Returns:
        The number of the process; None where there is none: kernels are kept, this process may use
        one core only, or forking is not safe here (it is on Linux).
    """
    if sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2:
        return None
    if all(is_kept(found.kernel) for found in kernels):
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # NumPy's threads are idle at a fork
        process = os.fork()
    if process:
        return process
    try:
        silence = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):  # who reads this run's output does not wait for the child's end
            os.dup2(silence, stream)
        compile_kernels(kernels)
    finally:
        os._exit(0)


def compile_kernels(kernels: Sequence[KernelTypes]) -> None:
    """Compile kernels for their types, or load what the disk keeps of them."""
    for found in kernels:
        found.kernel.compile(sigutils.normalize_signature(found.types)[0])


def is_kept(kernel: Any) -> bool:
    """Return whether the disk cache has an index of a kernel, possibly of an earlier version."""
    folder = kernel.stats.cache_path
    if folder is None:
        return True  # no cache folder: compiling ahead would be lost
    return any(Path(folder).glob(f"*.{kernel.py_func.__name__}-*.nbi"))
