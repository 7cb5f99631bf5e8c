"""How near each kernel of the CPU renderer comes to the machine's limits.

Counting rules
--------------
* Time: every Numba kernel that Python calls during a forward and a backward pass is timed at its
  call; the rest of the pass is PyTorch and Python. As with the limits, the fastest of all repeats
  counts, so that other jobs affect neither.
* Bytes: the sizes of all arrays that a kernel receives, each counted once, whether read or written:
  the least traffic that the kernel's interface allows. Arrays may stay in the caches or be read
  only in part, so a share of the limit may exceed one.
* Operations, for the two compositing kernels only: pixels that are visited (the rows of a tile that
  an entry reaches, entries behind a finished tile not counted) times float32 additions,
  subtractions, multiplications and divisions in the inner loop. Comparisons, minima and selects
  are not counted. The limit counts a multiply-add as 2.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any
from unittest import mock

import numba
import numpy as np
import torch

from gscomplete.render import cpu, render
from gscomplete.render.cpu.composite import pixel_rows
from gscomplete.render.cpu.layout import P_HALF_H, P_V
from gscomplete.splats import Splats
from gscomplete.util.kernels import run_kernel
from gscomplete.views import Cameras
from recipes.benchmarks.renderer.machine_limits import MachineLimits
from recipes.benchmarks.renderer.scenes import trainable_copy

FORWARD_OPERATIONS = 38
"""In the inner loop of ``composite``: offset 2, whitening 4, exponent 4, exp 17, alpha and weight
2, four accumulators 8, transmittance 1."""
BACKWARD_OPERATIONS = 64
"""In that of ``composite_backward``: alpha 28 as above, weight 1, value 8, what is behind 2,
gradient 5, transmittance 1, ten sums 19."""
OTHER = "PyTorch and Python"
_CALLED_BY_PYTHON = ("place_entries", "count_in_front", "used_bands")
"""Kernels that are not shared out among threads."""


@dataclass(frozen=True, slots=True)
class Stage:
    """One kernel of a render."""

    name: str
    ms: float
    """Fastest time."""
    megabytes: float | None = None
    memory_share: float | None = None
    """Bytes over time over the copy rate."""
    gflop: float | None = None
    arithmetic_share: float | None = None
    """Operations over time over the rate of multiply-adds."""


class _Recorder:
    """Seconds and arguments of kernel calls."""

    def __init__(self, read: Callable[[], float]) -> None:
        self.read = read
        self.seconds: dict[str, float] = defaultdict(float)
        self.arguments: dict[str, dict[str, Any]] = {}

    def take(self, kernel: Any, call: Callable[[], Any], arguments: Sequence[Any]) -> Any:
        """Make a call of a kernel and take its time."""
        name, signature = kernel.__name__, inspect.signature(kernel.py_func)
        start = self.read()
        result = call()
        self.seconds[name] += self.read() - start
        self.arguments[name] = dict(signature.bind(*arguments).arguments)
        return result

    def wrap(self, kernel: Any) -> Callable[..., Any]:
        """Return a function that calls the kernel and takes its time."""
        return lambda *arguments: self.take(kernel, lambda: kernel(*arguments), arguments)

    def run_kernel(self, kernel: Any, count: int, grain: int, *arguments: Any) -> None:
        """Share a kernel's tasks out and take the time."""
        call = functools.partial(run_kernel, kernel, count, grain, *arguments)
        self.take(kernel, call, (0, count, *arguments))


@contextlib.contextmanager
def _recorded(read: Callable[[], float]) -> Iterator[_Recorder]:
    """Time every kernel that Python code of the CPU renderer calls."""
    recorder = _Recorder(read)
    loaded = [m for name, m in sys.modules.items() if name.startswith(cpu.__name__ + ".")]
    with contextlib.ExitStack() as patches:
        for module in loaded:
            for name, value in vars(module).copy().items():
                if name in _CALLED_BY_PYTHON:
                    patches.enter_context(mock.patch.object(module, name, recorder.wrap(value)))
                elif value is run_kernel:
                    patches.enter_context(mock.patch.object(module, name, recorder.run_kernel))
        yield recorder


@numba.njit(cache=True)
def _visited_pixels(
    rows: Any, tile_start: Any, entries: Any, done: Any, tiles_x: int
) -> int:  # pixels
    """Count the pixels of all entries up to where every tile stopped."""
    total = 0
    for tile in range(done.shape[0]):
        for e in range(tile_start[tile], tile_start[tile] + done[tile]):
            row = rows[entries[e]]
            low, high = pixel_rows(row[P_V], row[P_HALF_H], tile // tiles_x)
            total += high - low
    return total


def measure_stages(
    splats: Splats,
    cameras: Cameras,
    limits: MachineLimits,
    repeats: int,
    read: Callable[[], float] = time.perf_counter,
) -> list[Stage]:
    """Split one forward and backward pass into kernels and compare them with the limits.

    Args:
        splats: what is drawn; all of it takes gradients.
        cameras: one view.
        limits: the machine's, with the number of threads that Numba uses now.
        repeats: timed passes, after one that is not.
        read: the clock, in seconds.
    """
    trainable = trainable_copy(splats)
    upstream = torch.randn(1, cameras.height, cameras.width, 3)
    render(trainable, cameras, backend="cpu").color.backward(upstream)
    passes: list[dict[str, float]] = []
    with _recorded(read) as recorder:
        for _ in range(repeats):
            recorder.seconds.clear()
            for _, value in trainable.fields():
                value.grad = None
            start = read()
            render(trainable, cameras, backend="cpu").color.backward(upstream)
            total = read() - start
            rest = total - sum(recorder.seconds.values())
            passes.append(dict(recorder.seconds) | {OTHER: rest})
    milliseconds = {name: 1e3 * min(one[name] for one in passes) for name in passes[0]}
    operations = _operations(recorder.arguments)
    return [
        _stage(name, ms, recorder.arguments.get(name), operations.get(name), limits)
        for name, ms in milliseconds.items()
    ]


def _operations(arguments: dict[str, dict[str, Any]]) -> dict[str, float]:
    """Count the operations of the compositing kernels."""
    drawn = arguments["composite"]
    pixels = _visited_pixels(
        drawn["rows"], drawn["tile_start"], drawn["entries"], drawn["done"], drawn["tiles_x"]
    )
    return {
        "composite": FORWARD_OPERATIONS * float(pixels),
        "composite_backward": BACKWARD_OPERATIONS * float(pixels),
    }


def _stage(
    name: str,
    ms: float,
    arguments: dict[str, Any] | None,
    operations: float | None,
    limits: MachineLimits,
) -> Stage:
    """Turn time, arrays and operations into shares."""
    if arguments is None:
        return Stage(name, ms)
    size = sum(value.nbytes for value in arguments.values() if isinstance(value, np.ndarray))
    memory = size / (ms * 1e-3) / (limits.copy_gb_s * 1e9)
    if operations is None:
        return Stage(name, ms, size / 1e6, memory)
    arithmetic = operations / (ms * 1e-3) / (limits.gflop_s * 1e9)
    return Stage(name, ms, size / 1e6, memory, operations / 1e9, arithmetic)
