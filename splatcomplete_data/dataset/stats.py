"""What a dataset holds: a row per object, sums per subset, and a contact sheet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from gscomplete.errors import UserError
from gscomplete.splats import transform_splats, usable_rows
from gscomplete.util.file_names import DATASET_FILE
from splatcomplete_data.dataset.validate import object_folders, read_index
from splatcomplete_data.objects import Subset, read_object, read_record


@dataclass(frozen=True, slots=True)
class ObjectRow:
    """One object in a table."""

    id: str
    folder: str
    """Its folder, relative to the dataset."""
    subset: Subset
    prompt: str
    partial: int
    complete: int
    """0 = not known."""
    view_deg: tuple[float, float]
    range_deg: float
    megabytes: float
    licence: str
    in_recipe: bool | None
    """Whether the recipe of the last build has it; None = not known."""


@dataclass(frozen=True, slots=True)
class Survey:
    """The objects of a dataset that can be read."""

    rows: tuple[ObjectRow, ...]
    """A row per object, by subset and id."""
    notes: tuple[str, ...]
    """Which folders were left out and why, and which objects the recipe does not have."""


def survey(dataset: Path) -> Survey:
    """Read the records of a dataset, leaving out folders without a sound one.

    Raises:
        UserError: there is no object that can be read.
    """
    listed = None
    rows, notes = [], []
    folders = object_folders(dataset)
    if folders != [dataset]:
        try:
            listed = read_index(dataset)
        except UserError as error:
            notes.append(str(error))
    for folder in folders:
        try:
            record = read_record(folder)
        except UserError as error:
            notes.append(f"left out: {error}")
            continue
        rows.append(
            ObjectRow(
                record.id,
                folder.relative_to(dataset).as_posix(),
                record.subset,
                record.prompt,
                record.counts.get("partial", 0),
                record.counts.get("complete", 0),
                (record.views.azimuth_deg, record.views.elevation_deg),
                record.views.azimuth_range_deg,
                sum(file.bytes for file in record.files.values()) / 1e6,
                record.source.licence or "not stated",
                None if listed is None else folder.name in listed,
            )
        )
        if rows[-1].in_recipe is False:
            notes.append(f"not in the recipe (by {DATASET_FILE}): {record.id}")
    if not rows:
        raise UserError(f"{dataset}: expected objects, found none; {notes[0]}")
    return Survey(tuple(sorted(rows, key=lambda row: (row.subset, row.id))), tuple(notes))


def draw_sheet(
    dataset: Path, rows: Sequence[ObjectRow], size_px: int = 160, columns: int = 6
) -> Image.Image:
    """Draw every object from its input view c and from the opposite side.

    Raises:
        UserError: an object cannot be read or drawn.
    """
    from gscomplete.evaluate.pictures import contact_sheet, render_images

    tiles = []
    for row in rows:
        item = read_object(dataset / row.folder)
        usable = usable_rows(item.partial)[0]
        if not bool(usable.any()):
            raise UserError(f"{item.folder}: no splat can be drawn")
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
