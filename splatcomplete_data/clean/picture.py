"""Draw splats before and after cleaning, and what went.

Conventions
-----------
* One column for every camera; the pictures of what went are drawn over white, so that faint haze
  shows.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from PIL import Image

from gscomplete.evaluate.pictures import LIGHT_GREY, contact_sheet, to_image
from gscomplete.render import render
from gscomplete.render.settings import RenderSettings
from gscomplete.splats import Splats
from gscomplete.views import Cameras


def clean_sheet(
    before: Splats, after: Splats, removed: Splats, cameras: Sequence[Cameras], near: float
) -> Image.Image:
    """Show splats before and after, and what was removed, from every camera.

    Args:
        before: all that can be drawn.
        after: what stays.
        removed: what goes.
        cameras: to draw from, one view each.
        near: splats nearer to a camera are not drawn.
    """
    settings = RenderSettings(near=near)
    rows = []
    for splats, grey in ((before, LIGHT_GREY), (after, LIGHT_GREY), (removed, (1.0, 1.0, 1.0))):
        pictures = []
        for camera in cameras:
            picture = Image.new("RGB", (camera.width, camera.height), "white")
            if len(splats):
                view = camera.to(dtype=torch.float32)
                with torch.no_grad():
                    color = render(splats, view, torch.tensor(grey), settings=settings).color[0]
                picture = to_image(color)
            pictures.append(picture)
        rows.append(pictures)
    return contact_sheet(rows, row_labels=["before", "after", "removed"])
