"""Our cameras as MVDream's camera matrices: the one place where the two frames meet.

Conventions
-----------
* MVDream's matrix is world-from-camera, row-major, with OpenGL camera axes (x right, y up, looking
  along -z) in Blender's world (z up), which our object frame is too.
* Its translation is divided by its length (+ 1e-8): a direction from the world's origin. Distance
  and field of view are not told, so the object must be centred there, as the object frame is.
* MVDream calls a = A + 90 degrees what we call azimuth A; matrices do not show the difference.
  Its front is +x (A = 0). A run may say that its object's front is at another azimuth.
* Our cameras have OpenCV axes: y and z point the other way.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from gscomplete.views import Cameras


def camera_matrices(cameras: Cameras, front_azimuth_deg: float = 0.0) -> Tensor:  # [V, 16]
    """Return the numbers that MVDream is given for each camera.

    Computed in float64, returned in float32.

    Args:
        cameras: in the object frame, looking at its origin.
        front_azimuth_deg: azimuth of the object's front; the world is turned about z so that it
            comes to lie at +x.
    """
    camera_from_world = cameras.camera_from_world.double()
    rotation = camera_from_world[:, :3, :3].transpose(1, 2)  # columns: camera axes in the world
    position = -(rotation @ camera_from_world[:, :3, 3:])
    opengl = rotation * rotation.new_tensor([1.0, -1.0, -1.0])
    turn = _about_z(-front_azimuth_deg).to(opengl)
    direction = position / (position.norm(dim=1, keepdim=True) + 1e-8)
    matrix = torch.zeros_like(camera_from_world)
    matrix[:, :3, :3] = turn @ opengl
    matrix[:, :3, 3:] = turn @ direction
    matrix[:, 3, 3] = 1.0
    return matrix.reshape(-1, 16).float()


def _about_z(degrees: float) -> Tensor:  # [3, 3]
    """Return the rotation about z, anticlockwise seen from above."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
