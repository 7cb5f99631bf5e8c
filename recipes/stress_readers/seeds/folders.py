"""Files that describe folders: object.json, dataset.json, recipes, manifests of batches."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path


def folder_seeds(folder: Path) -> list[tuple[str, Callable[[Path], object]]]:
    """Write the files; return each with its reader."""
    from gscomplete.batch.manifest import plan
    from gscomplete.cli.batch_job import ITEM_FIELDS
    from gscomplete.folders import read_object_folder
    from gscomplete.util import jsonio
    from gscomplete.views import ObjectFrame, ViewDistribution
    from splatcomplete_data.dataset.recipe import read_recipe
    from splatcomplete_data.dataset.validate import read_index
    from splatcomplete_data.objects import ObjectRecord, SourceRecord, read_record

    frame = ObjectFrame("Z", (0.0, 0.0, 0.0), 1.0)
    views = ViewDistribution(0.0, 10.0)
    record = ObjectRecord("a", "mesh", "a box", SourceRecord("m.obj"), frame, "truth", views)
    jsonio.write_json(folder / "object.json", record.to_json())
    index = {"schema": "splatcomplete.dataset", "version": 1}
    index["objects"] = [{"id": "a", "object_sha256": "0" * 64, "subset": "mesh"}]
    (folder / "dataset.json").write_text(json.dumps(index))
    (folder / "r.yaml").write_text(
        "schema: splatcomplete.recipe\nversion: 1\nname: x\nobjects:\n"
        "  - {id: a, command: mesh, file: m.obj, count: 100, cut: ['plane:90'], prompt: p}\n"
    )
    rows = [{"partial": f"{name}.ply", "prompt": "a mug", "seed": 3} for name in "ab"]
    (folder / "batch.jsonl").write_text("\n".join(map(json.dumps, rows)))
    (folder / "batch.csv").write_text("partial,prompt,up\na.ply,a mug,Z\nb.ply,a cup,-Y\n")
    return [
        ("object.json", lambda path: read_record(path.parent)),
        ("object.json", lambda path: read_object_folder(path.parent)),
        ("dataset.json", lambda path: read_index(path.parent)),
        ("dataset.json", lambda path: plan(str(path.parent), ITEM_FIELDS)),
        ("r.yaml", read_recipe),
        *(
            (name, lambda path: plan(str(path), ITEM_FIELDS))
            for name in ("batch.jsonl", "batch.csv")
        ),
    ]
