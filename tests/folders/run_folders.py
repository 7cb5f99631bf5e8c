"""Run folders as a completion leaves them, without completing anything."""

import json
from pathlib import Path

from gscomplete.folders import read_object_folder
from gscomplete.splats import Splats, append_splats, read_splats
from gscomplete.splats.transform import transform_splats


def write_run_folder(folder: Path, object_folder: Path, new: Splats, **changes: object) -> Path:
    """Write a finished run of an object; ``new`` is in the object frame."""
    known = read_object_folder(object_folder)
    folder.mkdir(parents=True)
    source = read_splats(known.partial)
    placed = transform_splats(new, known.frame.file_from_object)
    append_splats(folder / "completed.ply", source, placed)
    record = {
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
