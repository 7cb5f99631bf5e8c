"""Draw boxes over pictures of splats, so that people can judge and correct them.

Conventions
-----------
* Kept boxes are green, removed ones red; edges are drawn over everything, hidden or not.
* Pictures are taken by the capture's own cameras where they are known, else from an orbit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from PIL import Image, ImageDraw

from gscomplete.evaluate.pictures import LIGHT_GREY, contact_sheet, to_image
from gscomplete.render import render
from gscomplete.render.settings import RenderSettings
from gscomplete.splats import Splats
from gscomplete.util.arrays import Float64Array
from gscomplete.views import Cameras
from splatcomplete_data.cuts.boxes import CropBox

_COLORS = {"keep": (20, 200, 60), "remove": (230, 30, 30)}
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1]


def box_corners(box: CropBox) -> Float64Array:  # [8, 3]
    """Return a box's corners in the file's frame; bit k of the index is the side along axis k."""
    signs = np.array([[(index >> axis & 1) * 2 - 1 for axis in range(3)] for index in range(8)])
    return np.array(box.center) + (signs * np.array(box.half_extents)) @ box.rotation.T


def draw_box(picture: Image.Image, box: CropBox, camera: Cameras, near: float) -> None:
    """Draw a box's edges into a picture of one camera; edges are cut at the near plane."""
    pose = camera.camera_from_world[0].double().numpy()
    corners = box_corners(box) @ pose[:3, :3].T + pose[:3, 3]
    focal = camera.focal_px[0].double().numpy()
    middle = camera.center_px[0].double().numpy()
    draw = ImageDraw.Draw(picture)
    width = max(2, picture.width // 200)
    for a, b in _EDGES:
        start, end = corners[a], corners[b]
        if max(start[2], end[2]) <= near:
            continue
        if min(start[2], end[2]) <= near:
            share = (near - start[2]) / (end[2] - start[2])
            cut = start + share * (end - start)
            start, end = (cut, end) if start[2] <= near else (start, cut)
        pixels = [point[:2] / point[2] * focal + middle for point in (start, end)]
        flat = [float(np.clip(value, -1e4, 1e4)) for pixel in pixels for value in pixel]
        draw.line(flat, fill=_COLORS[box.action], width=width)


def box_sheet(
    splats: Splats,  # everything
    kept: Splats,
    boxes: Sequence[CropBox],
    cameras: Sequence[Cameras],
    near: float,
) -> Image.Image:
    """Show boxes drawn over all splats, above what they keep, from every camera."""
    settings = RenderSettings(near=near)
    background = torch.tensor(LIGHT_GREY)
    scene_row, parts = [], []
    for camera in cameras:
        camera = camera.to(dtype=torch.float32)
        with torch.no_grad():
            pair = [
                render(part, camera, background, settings=settings).color[0]
                for part in (splats, kept)
            ]
        picture, part = to_image(pair[0]), to_image(pair[1])
        for box in boxes:
            draw_box(picture, box, camera, near)
        scene_row.append(picture)
        parts.append(part)
    return contact_sheet([scene_row, parts], row_labels=["boxes", "kept"])
