"""What a dataset holds: a row per object, sums per subset, and a contact sheet."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from gscomplete.errors import UserError
from gscomplete.splats import transform_splats, usable_rows
from splatcomplete_data.dataset.validate import object_folders
from splatcomplete_data.objects import Subset, read_object, read_record


@dataclass(frozen=True, slots=True)
class ObjectRow:
    """One object in a table."""

    id: str
    subset: Subset
    prompt: str
    partial: int
    complete: int
    """0 = not known."""
    view_deg: tuple[float, float]
    range_deg: float
    megabytes: float
    licence: str


def table(dataset: Path) -> list[ObjectRow]:
    """Return a row per object, by subset and id.

    Raises:
        UserError: there is no object, or a record is broken.
    """
    rows = []
    for folder in object_folders(dataset):
        record = read_record(folder)
        rows.append(
            ObjectRow(
                record.id,
                record.subset,
                record.prompt,
                record.counts.get("partial", 0),
                record.counts.get("complete", 0),
                (record.views.azimuth_deg, record.views.elevation_deg),
                record.views.azimuth_range_deg,
                sum(file.bytes for file in record.files.values()) / 1e6,
                record.source.licence or "not stated",
            )
        )
    return sorted(rows, key=lambda row: (row.subset, row.id))


def draw_sheet(dataset: Path, size_px: int = 160, columns: int = 6) -> Image.Image:
    """Draw every object from its input view c and from the opposite side.

    Raises:
        UserError: there is no object, or one cannot be read.
    """
    from gscomplete.evaluate.pictures import contact_sheet, render_images

    tiles = []
    rows = table(dataset)
    folders = {read_record(folder).id: folder for folder in object_folders(dataset)}
    for row in rows:
        item = read_object(folders[row.id])
        usable = usable_rows(item.partial)[0]
        if not bool(usable.any()):
            raise UserError(f"{folders[row.id]}: no splat can be drawn")
        moved = transform_splats(item.partial.select(usable), item.record.frame.object_from_file)
        pictures = render_images(moved, item.record.views.ring(2, size_px))
        tiles.append(contact_sheet([pictures], title=f"{row.subset}: {row.id}"[:44]))
    width = max(tile.width for tile in tiles)
    padded = []
    for tile in tiles:
        box = Image.new("RGB", (width, max(t.height for t in tiles)), (245, 245, 245))
        box.paste(tile, (0, 0))
        padded.append(box)
    grid = [padded[start : start + columns] for start in range(0, len(padded), columns)]
    return contact_sheet(grid, title=f"{len(rows)} objects, each from c and from behind")
