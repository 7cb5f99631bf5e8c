"""Cameras, the object frame and view distributions."""

from gscomplete.views.cameras import (
    Cameras,
    focal_from_fov,
    four_view_orbit,
    join_cameras,
    orbit_cameras,
    radius_to_fit,
)

__all__ = [
    "Cameras",
    "focal_from_fov",
    "four_view_orbit",
    "join_cameras",
    "orbit_cameras",
    "radius_to_fit",
]
