"""Differentiable rendering of splats: one call, several backends."""

from gscomplete.render.dispatch import Backend, render
from gscomplete.render.record import Render
from gscomplete.render.settings import RenderSettings

__all__ = ["Backend", "Render", "RenderSettings", "render"]
