"""Draw one picture with several samples of every family, to look at.

Usage: ``python -m recipes.train_embedded_prior.procedural.contact_sheet --out sheet.png``.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import tyro
from PIL import Image, ImageDraw

from gscomplete.render import render
from gscomplete.splats.record import Splats
from gscomplete.views import orbit_cameras
from gscomplete.views.cameras import radius_to_fit
from recipes.entry_point import start
from recipes.train_embedded_prior.procedural.objects import FAMILIES, make_object_of
from splatcomplete_data.cuts.random_cuts import random_partial
from splatcomplete_data.flaws import corrupt

LOG = logging.getLogger(__name__)
_PER_ROW = 3
"""Families side by side."""


@dataclass(frozen=True)
class SheetSettings:
    """What to draw."""

    out: Path = Path("contact_sheet.png")
    """Where to write the picture."""
    families: tuple[str, ...] = ()
    """Families to draw, none = all."""
    samples: Annotated[int, tyro.conf.arg(aliases=["-n"])] = 6
    """Samples of each family."""
    size_px: int = 96
    """Side of one sample."""
    seed: int = 0
    """Seed of the objects."""
    first: int = 0
    """Index of the first sample."""
    partial: bool = False
    """Draw random partials of the objects instead."""


def thumbnail(splats: Splats, size_px: int) -> np.ndarray:  # [size_px, size_px, 3] uint8
    """Render an object from the front, a little from above, on light grey."""
    radius = radius_to_fit(1.45, 30.0)
    angles = torch.tensor([30.0]), torch.tensor([20.0])
    cameras = orbit_cameras(*angles, radius=radius, fov_deg=30.0, size_px=size_px)
    color = render(splats, cameras, torch.full((3,), 0.8)).color[0]
    return (color.clamp(0, 1) * 255).byte().numpy()


def contact_sheet(settings: SheetSettings) -> Image.Image:
    """Draw the families' samples in rows, names above and captions below them."""
    names = settings.families or tuple(FAMILIES)
    px, line = settings.size_px, 12
    rows = -(-len(names) // _PER_ROW)
    width = _PER_ROW * (settings.samples * px + 8)
    sheet = Image.new("RGB", (width, rows * (px + line)), "white")
    pen = ImageDraw.Draw(sheet)
    for k, name in enumerate(names):
        left = (k % _PER_ROW) * (settings.samples * px + 8)
        top = (k // _PER_ROW) * (px + line)
        captions = []
        for n in range(settings.samples):
            index = settings.first + n
            made = make_object_of(name, settings.seed, index)
            splats = made.splats
            if settings.partial:
                cut = random_partial(splats, settings.seed, index)
                splats = corrupt(splats, cut.mask, settings.seed, index)
            picture = Image.fromarray(thumbnail(splats, px))
            sheet.paste(picture, (left + n * px, top + line))
            captions.append(made.caption)
        pen.text((left + 2, top), f"{name}: {captions[0]}"[: settings.samples * px // 6], "black")
        LOG.info("%s: %s", name, "; ".join(captions))
    return sheet


def main(settings: SheetSettings) -> None:
    """Write the contact sheet."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    contact_sheet(settings).save(settings.out)
    LOG.info("wrote %s", settings.out)


if __name__ == "__main__":
    start(main, SheetSettings, __doc__)
