"""What the page says of one completion: a picture, numbers, splats, options, timings, warnings."""

from __future__ import annotations

import base64
import io
from typing import Any

import torch
from PIL import Image

from gscomplete.evaluate.pictures import LIGHT_GREY, error_picture, to_image
from gscomplete.evaluate.rows import Row
from gscomplete.evaluate.subject import Subject
from gscomplete.render import render
from gscomplete.report.packed_splats import packed
from gscomplete.splats import Splats
from gscomplete.views import Cameras

VIEWS_DEG = (0.0, 60.0, 180.0)
"""Azimuths of the pictures from c."""
_PICTURE_PX = 176
_INSET_SHARE = 0.34


def card_of(subject: Subject, row: Row, most_splats: int) -> dict[str, Any]:
    """Return the card as JSON values.

    Args:
        subject: the completion.
        row: its numbers.
        most_splats: at most so many splats of the input, and of what was added, are shown.
    """
    begin = len(subject.partial) if subject.holds_partial else 0
    added = subject.completed.select(torch.arange(len(subject.completed)) >= begin)
    return {
        "method": row.method,
        "object": row.object,
        "subset": row.subset,
        "prompt": subject.prompt,
        "values": row.values,
        "seconds": row.seconds,
        "unavailable": row.unavailable,
        "notes": list(row.notes),
        "settings": subject.settings,
        "sources": subject.sources,
        "timings": subject.timings,
        "azimuth_deg": subject.views.azimuth_deg,
        "elevation_deg": subject.views.elevation_deg,
        "picture": _picture(subject),
        "input": packed(subject.partial, most_splats),
        "added": packed(added, most_splats),
        "holds_input": subject.holds_partial,
    }


def _picture(subject: Subject) -> str:
    """Draw input above completion from the same views, errors on P inset; as a data URL."""
    views = subject.views.to_show(subject.completed.means.double().numpy())
    ring = views.ring(360, _PICTURE_PX)
    cameras = ring[[int(angle) for angle in VIEWS_DEG]]
    sheet = Image.new("RGB", (_PICTURE_PX * len(VIEWS_DEG), 2 * _PICTURE_PX))
    side = int(_INSET_SHARE * _PICTURE_PX)
    with torch.no_grad():
        shown = [_colors(splats, cameras) for splats in (subject.partial, subject.completed)]
    for column, angle_deg in enumerate(VIEWS_DEG):
        for line, (color, _) in enumerate(shown):
            sheet.paste(to_image(color[column]), (_PICTURE_PX * column, _PICTURE_PX * line))
        if angle_deg > subject.views.azimuth_range_deg:
            continue  # from behind, P is to be covered
        alpha = shown[0][1][column]
        inset = error_picture(shown[1][0][column], shown[0][0][column], alpha)
        mask = to_image(alpha[..., None].expand(-1, -1, 3)).convert("L")
        small = [p.resize((side, side), Image.Resampling.LANCZOS) for p in (inset, mask)]
        corner = (_PICTURE_PX * (column + 1) - side, 2 * _PICTURE_PX - side)
        sheet.paste(small[0], corner, small[1])
    out = io.BytesIO()
    sheet.save(out, format="WEBP", quality=82)
    return "data:image/webp;base64," + base64.b64encode(out.getvalue()).decode("ascii")


def _colors(splats: Splats, cameras: Cameras) -> tuple[torch.Tensor, torch.Tensor]:
    view = render(splats, cameras, splats.means.new_tensor(LIGHT_GREY))
    return view.color, view.alpha
