"""Object folders as the data side writes them, and run folders as a completion leaves them."""

import dataclasses
import json
from pathlib import Path

from PIL import Image

from gscomplete.folders import read_object_folder
from gscomplete.splats import Splats, append_splats, read_splats
from gscomplete.splats.transform import transform_splats
from gscomplete.views import ObjectFrame, ViewDistribution
from splatcomplete_data.cuts.boxes import CropBox
from splatcomplete_data.objects import (
    PREVIEW_FILE,
    ObjectRecord,
    SourceRecord,
    StepRecord,
    write_object,
)


def object_record(**changes: object) -> ObjectRecord:
    """Return the record of a ball; ``changes`` replace fields."""
    base = ObjectRecord(
        id="ball",
        subset="mesh",
        prompt="a ball",
        source=SourceRecord("ball.obj", licence="CC0"),
        frame=ObjectFrame("Z", (0.0, 0.0, 0.0), 1.0),
        frame_origin="truth",
        views=ViewDistribution(30.0, 15.0),
        boxes=(CropBox((0, 0, 0), (1, 1, 1)),),
        steps=(StepRecord("cut", 400, 200, {"plane": 200}),),
    )
    return dataclasses.replace(base, **changes)  # type: ignore[arg-type]


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
    pictures = {PREVIEW_FILE: Image.new("RGB", (4, 4))}
    write_object(folder, record, partial, complete, pictures=pictures)
    return folder


def write_run_folder(folder: Path, object_folder: Path, new: Splats, **changes: object) -> Path:
    """Write a finished run of an object; ``new`` is in the object frame."""
    known = read_object_folder(object_folder)
    folder.mkdir(parents=True)
    source = read_splats(known.partial)
    placed = transform_splats(new, known.frame.file_from_object)
    append_splats(folder / "completed.ply", source, placed)
    record = {
        "schema": "gscomplete.run",
        "status": "finished",
        "input": {"path": str(known.partial), "splats": len(source.splats),
                  "object": str(object_folder), "sources": {"prompt": "object.json"}},
        "identity": {
            "prompt": known.prompt,
            "frame": known.frame.to_json(),
            "views": known.views.to_json(),
            "prior": {"name": "embedded"},
            "settings": {"start": "guess", "steps": 0, "seed": 0},
        },
        "notes": ["a note <of> the run"],
        "timings": {"prepare_s": 1.0, "optimise_s": 2.0, "finish_s": 0.5},
    }  # fmt: skip
    (folder / "run.json").write_text(json.dumps(record | changes))
    return folder
