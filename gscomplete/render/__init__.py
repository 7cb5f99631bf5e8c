"""Differentiable rendering of splats: one call, several backends."""

from gscomplete.render.dispatch import Backend, prepare_frozen, render
from gscomplete.render.frozen import PreparedFrozen, join_prepared
from gscomplete.render.record import Render
from gscomplete.render.settings import RenderSettings

__all__ = [
    "Backend",
    "PreparedFrozen",
    "Render",
    "RenderSettings",
    "join_prepared",
    "prepare_frozen",
    "render",
]
