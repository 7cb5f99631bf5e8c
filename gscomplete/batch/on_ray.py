"""Workers of a Ray cluster: Ray decides where and how often a task is tried, and keeps no results.

Conventions
-----------
* A task requests cores, memory and, if wanted, one GPU. Ray starts a process for it where these are
  free, and reuses that process for the next task, so that kernels and weights stay loaded.
* Every machine of the cluster has GSComplete installed and sees the same paths or stores.
"""

from __future__ import annotations

import importlib
import os
import signal
import socket
import threading
from collections.abc import Callable, Generator, Iterable
from typing import Any, TypeVar

from gscomplete.batch.local_workers import SECONDS_TO_END, Done, limit_memory
from gscomplete.batch.machine import WorkerPlan
from gscomplete.errors import UserError

T = TypeVar("T")
R = TypeVar("R")

_TICK_S = 0.2
_AHEAD = 2
"""Tasks given to Ray for each that the cluster can do at a time: few enough to wait in its memory,
enough that no worker waits for the next."""
_SECONDS_TO_ANSWER = 10.0
_PASSED_ON = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")
"""Environment variables that workers get as they are here."""


def run_on_ray(
    function: Callable[[T], R],
    tasks: Iterable[T],
    plan: WorkerPlan,
    address: str,
    *,
    retries: int = 2,
    on_tick: Callable[[list[T]], None] = lambda running: None,
) -> Generator[Done[T, R], None, None]:
    """Give tasks to a cluster, and yield each as it ends.

    Args:
        function: does a task; importable on all machines.
        tasks: what is to be done, in order.
        plan: threads and memory of each task; the number of workers counts for ``local`` only.
        address: of a cluster, ``auto`` = the one of this machine, ``local`` = started here and
            ended with the call.
        retries: how many further workers try a task whose worker died.
        on_tick: called several times a second with the tasks that are being done or wait for a
            worker.

    Raises:
        UserError: Ray is not installed, or there is no such cluster.
    """
    ray = _connect(plan, address)
    needs = {"num_cpus": plan.threads, "memory": plan.memory_bytes}
    if plan.gpus:
        needs["num_gpus"] = 1
    limit = 0 if plan.gpus else plan.memory_bytes
    remote = ray.remote(_do).options(max_retries=retries, **needs)
    waiting = iter(tasks)
    running: dict[Any, T] = {}
    try:
        while True:
            most = _AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)) // plan.threads)
            while len(running) < most:
                task = next(waiting, None)
                if task is None:
                    break
                running[remote.remote(function, task, limit)] = task
            if not running:
                return
            on_tick(list(running.values()))
            for reference in ray.wait(list(running), num_returns=1, timeout=_TICK_S)[0]:
                task = running.pop(reference)
                try:
                    yield Done(task, ray.get(reference), 1)
                except ray.exceptions.RayTaskError as error:
                    raise error.cause if isinstance(error.cause, Exception) else error from None
                except ray.exceptions.RayError:  # a worker or machine died once too often
                    yield Done(task, None, retries + 1)
    finally:
        for reference in running:
            ray.cancel(reference, force=False)
        if running:
            ray.wait(list(running), num_returns=len(running), timeout=SECONDS_TO_END)
        ray.shutdown()


def _connect(plan: WorkerPlan, address: str) -> Any:
    """Connect to a cluster and return Ray.

    Raises:
        UserError: Ray is not installed, or there is no such cluster.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        ray = importlib.import_module("ray")
    except ImportError as error:
        raise UserError(
            f'--ray: needs an optional dependency: pip install "gscomplete[ray]" ({error})'
        ) from error
    _require_reachable(address)
    variables = plan.environment()
    variables.pop("CUDA_VISIBLE_DEVICES", None)  # Ray sets it itself
    variables |= {name: os.environ[name] for name in _PASSED_ON if name in os.environ}
    runtime = {"env_vars": variables}
    common = {"runtime_env": runtime, "log_to_driver": False, "logging_level": "error"}
    before = signal.getsignal(signal.SIGTERM)
    try:
        if address == "local":
            ray.init(
                address="local",
                num_cpus=plan.count * plan.threads,
                include_dashboard=False,
                **common,
            )
        else:
            ray.init(address=address, **common)
    except (ConnectionError, ValueError, RuntimeError) as error:
        reason = str(error).strip().split("\n")[0]
        raise UserError(f"--ray {address}: cannot connect to a cluster ({reason})") from error
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, before)  # Ray's handler ends the process at once
    return ray


def _require_reachable(address: str) -> None:
    """Require that something listens at HOST:PORT; Ray itself waits many minutes for it.

    Raises:
        UserError: nothing does.
    """
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not (colon and port.isdigit()):
        return
    try:
        socket.create_connection((host, int(port)), timeout=_SECONDS_TO_ANSWER).close()
    except (OSError, OverflowError) as error:
        raise UserError(f"--ray {address}: cannot connect to a cluster ({error})") from error


def _do(function: Callable[[T], R], task: T, memory_bytes: int) -> R:
    """Do a task in a process of Ray's."""
    if memory_bytes:
        limit_memory(memory_bytes)
    return function(task)
