"""What a result's bytes depend on besides its input: versions and the kind of processor.

Conventions
-----------
* The same seed gives the same bytes for the same versions and kind of processor, whatever the
  number of threads (``same_bits``). Thread counts are recorded only to explain different speeds.
"""

from __future__ import annotations

import platform
from importlib.metadata import version
from typing import Any

import numba
import torch

import gscomplete


def made_with() -> dict[str, Any]:
    """Return versions, threads and the kind of processor, as JSON values."""
    return {
        "gscomplete": gscomplete.__version__,
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numpy": version("numpy"),
        "numba": version("numba"),
        "scipy": version("scipy"),
        "torch_threads": torch.get_num_threads(),
        "numba_threads": numba.get_num_threads(),
        "processor": f"{platform.machine()} {torch.backends.cpu.get_cpu_capability()}",
    }


def differences_note(before: object) -> tuple[str, ...]:
    """Describe what has changed since a run began, in one note; no note = nothing.

    Args:
        before: what :func:`made_with` returned then, read from a file that may be damaged.
    """
    if not isinstance(before, dict):
        return ()
    changed = [
        f"{name} {before[name]} (now {value})"
        for name, value in made_with().items()
        if not name.endswith("_threads") and name in before and before[name] != value
    ]
    if not changed:
        return ()
    return (
        f"resuming a run begun with {', '.join(changed)}: its bytes may differ from those of an "
        "uninterrupted run",
    )
