"""GSComplete: complete partial 3D objects made of Gaussian splats.

The public functions load on first use, so that importing the package costs nothing:

>>> import gscomplete
>>> prior = gscomplete.load_prior("embedded")  # once, for as many objects as you like
>>> result = gscomplete.complete("recipes/demo/partial.ply", "a mug", prior=prior)
>>> result.save("completed.ply")  # P's records first and byte for byte, new ones after
>>> picture = gscomplete.render_splats(result.in_object_frame, result.views.input_camera(256))
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gscomplete.api import complete
    from gscomplete.completion.pipeline import Completed
    from gscomplete.errors import UserError
    from gscomplete.priors import load_prior
    from gscomplete.render import render as render_splats
    from gscomplete.splats import Splats, read_splats, write_splats

__version__ = "0.1.0"

_HOMES = {
    "Completed": ("gscomplete.completion.pipeline", "Completed"),
    "Splats": ("gscomplete.splats", "Splats"),
    "UserError": ("gscomplete.errors", "UserError"),
    "complete": ("gscomplete.api", "complete"),
    "load_prior": ("gscomplete.priors", "load_prior"),
    "read_splats": ("gscomplete.splats", "read_splats"),
    "render_splats": ("gscomplete.render", "render"),
    "write_splats": ("gscomplete.splats", "write_splats"),
}

__all__ = [
    "Completed",
    "Splats",
    "UserError",
    "__version__",
    "complete",
    "load_prior",
    "read_splats",
    "render_splats",
    "write_splats",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its home (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module 'gscomplete' has no attribute {name!r}")
    module, attribute = _HOMES[name]
    return getattr(importlib.import_module(module), attribute)


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
