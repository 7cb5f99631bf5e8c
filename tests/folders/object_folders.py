"""Object folders as the data side writes them."""

from pathlib import Path

from PIL import Image

from gscomplete.splats import Splats
from gscomplete.views import ObjectFrame, ViewDistribution
from splatcomplete_data.objects import ObjectRecord, SourceRecord, write_object


def write_object_folder(
    folder: Path, partial: Splats, complete: Splats | None = None, **changes: object
) -> Path:
    """Write an object folder with a small picture; ``changes`` replace fields of its record."""
    values = {
        "id": folder.name,
        "subset": "mesh",
        "prompt": "a red mug",
        "source": SourceRecord("mug.glb"),
        "frame": ObjectFrame("Y", (0.1, 0.0, 0.0), 1.25),
        "frame_origin": "given",
        "views": ViewDistribution(30.0, 10.0, 40.0, 12.0),
    }
    record = ObjectRecord(**(values | changes))
    write_object(folder, record, partial, complete, preview=Image.new("RGB", (4, 4)))
    return folder
