"""Draw all real objects, complete and partial: ``python -m recipes.real_objects.contact_sheet``."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from gscomplete.evaluate import contact_sheet, render_images, save_image
from gscomplete.splats import transform_splats
from gscomplete.views import ObjectFrame, ViewDistribution
from recipes.entry_point import start
from recipes.real_objects.load import RealObject, load_real_object, names

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class SheetOptions:
    """Draw real objects, each complete and as part from two views."""

    data: Path = Path("../shared/data")
    """Folder with MANIFEST.tsv."""
    out: Path = Path("real_objects.png")
    """Picture to write."""
    only: tuple[str, ...] = ()
    """Names of objects; none = all."""
    size_px: int = 128
    """Side of one picture."""
    columns: int = 3
    """Objects next to each other."""


def object_row(item: RealObject, size_px: int) -> list[Image.Image]:
    """Draw the complete and the partial splats of one object from azimuths 30 and 210."""
    frame: ObjectFrame = item.true_frame or ObjectFrame.about(item.partial, item.up)
    pictures = []
    for splats in (item.complete, item.partial):
        if splats is None:
            continue
        moved = transform_splats(splats, frame.object_from_file)
        cameras = ViewDistribution(30.0, 25.0, radius=2.0).ring(2, size_px)
        pictures += render_images(moved, cameras)
    return pictures


def main(options: SheetOptions) -> None:
    """Write the contact sheet."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    tiles = []
    for name in options.only or names():
        item = load_real_object(name, options.data)
        row = object_row(item, options.size_px)
        counts = f"{name} [{item.up}] {len(item.partial)}"
        counts += "" if item.complete is None else f" of {len(item.complete)}"
        tiles.append(contact_sheet([row], title=f"{counts}: {item.prompt}"[:70]))
        _logger.info("%s: %s", name, item.note)
    rows = [tiles[i : i + options.columns] for i in range(0, len(tiles), options.columns)]
    save_image(contact_sheet(rows), options.out)


if __name__ == "__main__":
    start(main, SheetOptions, __doc__)
