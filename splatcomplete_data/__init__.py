"""Build partial and complete splat objects from meshes, scans and photos.

The public functions load on first use:

>>> import splatcomplete_data as data
>>> mug = data.mesh_to_splats("mug.obj", 30_000)
>>> part = data.cut(mug, ["plane:90"], up="Y")
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from splatcomplete_data.api import (
        crop,
        cut,
        depth_to_splats,
        mesh_to_splats,
        reconstruct,
        scan_to_splats,
    )

__all__ = [
    "crop",
    "cut",
    "depth_to_splats",
    "mesh_to_splats",
    "reconstruct",
    "scan_to_splats",
]


def __getattr__(name: str) -> Any:
    """Load a public function (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module 'splatcomplete_data' has no attribute {name!r}")
    return getattr(importlib.import_module("splatcomplete_data.api"), name)


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
