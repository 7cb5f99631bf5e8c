"""Cameras, the object frame and view distributions."""

from gscomplete.views.cameras import (
    Cameras,
    focal_from_fov,
    four_view_orbit,
    join_cameras,
    orbit_cameras,
    radius_to_fit,
)
from gscomplete.views.distribution import ViewDistribution
from gscomplete.views.frame import (
    FrameOrigin,
    GivenOfFrame,
    ObjectFrame,
    UpAxis,
    axis_direction,
    parse_up,
    up_rotation,
)

__all__ = [
    "Cameras",
    "FrameOrigin",
    "GivenOfFrame",
    "ObjectFrame",
    "UpAxis",
    "ViewDistribution",
    "axis_direction",
    "focal_from_fov",
    "four_view_orbit",
    "join_cameras",
    "orbit_cameras",
    "parse_up",
    "radius_to_fit",
    "up_rotation",
]
