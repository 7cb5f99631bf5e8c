"""Draw what cleaning removed: before, and after with the removed points in colours of their own."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from PIL import Image, ImageDraw

from gscomplete.evaluate.pictures import contact_sheet, render_images
from gscomplete.splats import Splats, colors_to_sh, transform_splats
from gscomplete.views import ObjectFrame, UpAxis, ViewDistribution
from splatcomplete_data.points import points_to_splats, thin_to_count
from splatcomplete_data.scan.make import Part

REASON_COLORS = {
    "planes": (0.95, 0.45, 0.10),
    "outliers": (0.90, 0.10, 0.55),
    "clutter": (0.20, 0.45, 0.95),
}
"""Colour of the points that a step removed."""
OTHER_COLOR = (0.3, 0.7, 0.3)
MAX_POINTS = 120_000


def removed_sheet(
    part: Part, up: UpAxis, view_deg: tuple[float, float], title: str, size_px: int = 320
) -> Image.Image:
    """Show the cloud as read, the cloud with its removed points coloured, and what is left."""
    mask, _ = thin_to_count(part.cloud.points, MAX_POINTS)
    cloud, reason = part.cloud.select(np.flatnonzero(mask)), part.reason[mask]
    turn = part.turn
    splats = points_to_splats(cloud.points - np.array(part.offset or 0.0), cloud.colors)
    if turn is not None:
        splats = transform_splats(splats, turn)
    tinted = splats.base_colors.clone()
    for index, name in enumerate(part.reasons):
        color = torch.tensor(REASON_COLORS.get(name, OTHER_COLOR))
        gone = torch.from_numpy(reason == index)
        tinted[gone] = 0.25 * tinted[gone] + 0.75 * color
    frame = ObjectFrame.about(splats, up)
    own = ObjectFrame.about(part.splats, up)
    shown = [
        (splats, frame),
        (dataclasses.replace(splats, sh=colors_to_sh(tinted)), frame),
        (part.splats, own),
    ]
    rows = []
    for azimuth in (0.0, 40.0):
        views = ViewDistribution(view_deg[0] + azimuth, max(view_deg[1], 20.0), radius=2.0)
        camera = views.input_camera(size_px)
        rows.append([render_images(_in(s, f), camera)[0] for s, f in shown])
    columns = ["before", "removed points in colour", "after"]
    sheet = contact_sheet(rows, column_labels=columns, title=title)
    return _legend(sheet, part)


def _in(splats: Splats, frame: ObjectFrame) -> Splats:
    """Move splats into their object frame."""
    return transform_splats(splats, frame.object_from_file)


def _legend(sheet: Image.Image, part: Part) -> Image.Image:
    """Add a line that says which colour means what, with counts."""
    taller = Image.new("RGB", (sheet.width, sheet.height + 22), (245, 245, 245))
    taller.paste(sheet, (0, 0))
    draw, x = ImageDraw.Draw(taller), 6
    for index, name in enumerate(part.reasons):
        color = tuple(round(255 * c) for c in REASON_COLORS.get(name, OTHER_COLOR))
        text = f"{name}: {int((part.reason == index).sum()):,}"
        draw.rectangle((x, sheet.height + 4, x + 12, sheet.height + 16), fill=color)
        draw.text((x + 17, sheet.height + 4), text, (40, 40, 40))
        x += 40 + int(draw.textlength(text))
    return taller
