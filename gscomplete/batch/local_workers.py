"""Worker processes of this machine that stay warm from task to task.

Conventions
-----------
* Each worker is a pool of one process (``concurrent.futures``): one that is killed takes only its
  own task with it, and the task goes to a new worker.
* Workers end when the process that started them ends, for whatever reason. Workers ignore SIGINT:
  the starting process handles it and sends its workers SIGTERM, which raises KeyboardInterrupt in a
  running task.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import active_children, get_context, parent_process
from types import FrameType
from typing import Generic, TypeVar

from gscomplete.batch.machine import GIB, WorkerPlan, available_bytes
from gscomplete.errors import UserError

T = TypeVar("T")
R = TypeVar("R")

_TICK_S = 0.2
SECONDS_TO_END = 30.0
"""A worker that was asked to end has this long to write its checkpoint."""


@dataclass(frozen=True, slots=True)
class Done(Generic[T, R]):
    """A task that ended."""

    task: T
    result: R | None
    """None = its workers died."""
    attempts: int
    """Workers that it was given to."""


def run_local(
    function: Callable[[T], R],
    tasks: Iterable[T],
    plan: WorkerPlan,
    *,
    enter: Callable[[], None] | None = None,
    retries: int = 2,
    on_tick: Callable[[list[T]], None] = lambda running: None,
) -> Generator[Done[T, R], None, None]:
    """Give tasks to workers, and yield each as it ends.

    Args:
        function: does a task; importable, as tasks and results are picklable.
        tasks: what is to be done, in order.
        plan: how many workers, and how large.
        enter: prepares a new worker; importable; None = nothing.
        retries: how many further workers try a task whose worker died.
        on_tick: called several times a second with the tasks that are being done.

    Raises:
        UserError: there is no memory for a single worker.
    """
    workers = [_Worker(plan, number, enter) for number in range(plan.count)]
    fresh, again = iter(tasks), deque[tuple[T, int]]()
    running: dict[Future[R], tuple[_Worker, T, int]] = {}
    try:
        while True:
            busy = {id(worker) for worker, _, _ in running.values()}
            for worker in workers:
                if id(worker) in busy or not worker.has_room(alone=not busy):
                    continue
                task, attempts = again.popleft() if again else (next(fresh, None), 0)
                if task is None:
                    break
                running[worker.submit(function, task)] = worker, task, attempts + 1
                busy.add(id(worker))
            if not running:
                return
            on_tick([task for _, task, _ in running.values()])
            ended, _ = wait(running, timeout=_TICK_S, return_when=FIRST_COMPLETED)
            for future in ended:
                worker, task, attempts = running.pop(future)
                if not _died(future):
                    yield Done(task, future.result(), attempts)
                    continue
                worker.forget()
                if attempts <= retries:
                    again.append((task, attempts))
                else:
                    yield Done(task, None, attempts)
    finally:
        _end(workers, stop=bool(running))


def _died(future: Future[R]) -> bool:
    """Tell whether a task's worker died during it, or was told to end by another process."""
    return isinstance(future.exception(), BrokenProcessPool | KeyboardInterrupt)


class _Worker:
    """One process, started when it is first needed and again after it died."""

    def __init__(self, plan: WorkerPlan, number: int, enter: Callable[[], None] | None) -> None:
        self._plan, self._number, self._enter = plan, number, enter
        self._pool: ProcessPoolExecutor | None = None

    def has_room(self, *, alone: bool) -> bool:
        """Tell whether the worker already runs, or enough memory is free to start it.

        Raises:
            UserError: memory is short, and no other worker runs that could end and free some.
        """
        if self._pool is not None:
            return True
        free = available_bytes()
        if free is None or free >= self._plan.memory_bytes:
            return True
        if alone:
            raise UserError(
                f"a worker needs {self._plan.memory_bytes / GIB:.1f} GiB of memory (--memory), "
                f"found {free / GIB:.1f} GiB free"
            )
        return False

    def submit(self, function: Callable[[T], R], task: T) -> Future[R]:
        """Start a task."""
        if self._pool is None:
            context = get_context("spawn")
            limit = 0 if self._plan.gpus else self._plan.memory_bytes
            self._pool = ProcessPoolExecutor(1, context, enter_worker, (self._enter, limit))
        with _environment(self._plan.environment(self._number)):  # submit() starts the process
            try:
                return self._pool.submit(_do, function, task)
            except BrokenProcessPool:  # it died between two tasks
                self.forget()
                return self.submit(function, task)

    def forget(self) -> None:
        """Drop a process that died."""
        self.end()
        self._pool = None

    def end(self) -> None:
        """Let the process end as soon as its task has ended."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)


def _end(workers: list[_Worker], *, stop: bool) -> None:
    """End all workers; those in the middle of a task only if asked to stop it."""
    children = active_children()
    for child in children if stop else ():
        child.terminate()
    for worker in workers:
        worker.end()
    deadline = time.monotonic() + SECONDS_TO_END
    for child in children:
        child.join(max(0.0, deadline - time.monotonic()))
        if child.is_alive():
            child.kill()


@contextlib.contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    """Set environment variables for processes started in the block."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


_at_work = False
"""Whether this process, a worker, is in the middle of a task."""


def enter_worker(enter: Callable[[], None] | None, memory_bytes: int) -> None:
    """Prepare a worker process.

    Args:
        enter: what the tasks need besides; None = nothing.
        memory_bytes: most memory that the process may take for data; 0 = no limit.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _stop)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if memory_bytes:
        limit_memory(memory_bytes)
    if enter is not None:
        enter()


def limit_memory(memory_bytes: int) -> None:
    """Limit this process's data memory, where the system can: a task fails, not the machine."""
    try:
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_DATA)
        resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, most))
    except (ImportError, OSError, ValueError):
        pass


def _do(function: Callable[[T], R], task: T) -> R:
    """Do a task in a worker, and mark it as running so that ``_stop`` can interrupt it."""
    global _at_work
    _at_work = True
    try:
        return function(task)
    finally:
        _at_work = False


def _stop(number: int, frame: FrameType | None) -> None:
    """Interrupt the running task as Ctrl-C would; end a worker without a task at once."""
    if _at_work:
        raise KeyboardInterrupt
    os._exit(128 + number)


def _end_with_parent() -> None:
    """End this process when its parent ends, so that it never writes during the next run."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
