"""Options that Numba compiles kernels with, and how long it compiles."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from numba.core import event

from gscomplete.util.stages import current_profile

KERNEL: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
}
"""Of functions that Python calls."""

HELPER: dict[str, Any] = {
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "no_cpython_wrapper": True,
}
"""Of functions that only kernels call. They compile in two thirds of the time when Python cannot
call them and the disk does not keep them."""


class _Compilations(event.Listener):
    """Counts compiling as a stage, and tells of the first time."""

    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell = tell
        self._depth = 0

    def on_start(self, event: event.Event) -> None:
        """Begin to compile a kernel, or within that what it calls."""
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
    """Call ``tell`` before the first kernel that has to be compiled, and count a stage of them.

    Kernels that the disk keeps are loaded, which is not compiling.
    """
    with event.install_listener("numba:compile", _Compilations(tell)):
        yield
