import json

import pytest

from gscomplete.batch.ledger import Ledger, Row
from gscomplete.errors import UserError
from recipes.benchmarks.batch.__main__ import Options, _row, _twice
from recipes.benchmarks.batch.objects import make_objects


def test_objects_of_a_dataset_come_first(tmp_path):
    for name in ("cow", "owl"):
        (tmp_path / "data" / name).mkdir(parents=True)
        (tmp_path / "data" / name / "object.json").touch()
    manifest = make_objects(tmp_path / "out", tmp_path / "data", None, 1)
    assert json.loads(manifest.read_text()) == {"id": "cow", "partial": f"{tmp_path}/data/cow"}
    with pytest.raises(UserError, match="expected 3 objects, found 2"):
        make_objects(tmp_path / "out", tmp_path / "data", None, 3)


def test_other_bytes_and_objects_done_twice_or_lost_are_told(tmp_path):
    rows = [{"id": name} for name in ("same", "other", "lost")]
    for way in ("one-by-one", "local"):
        for row in rows:
            folder = tmp_path / way / row["id"]
            folder.mkdir(parents=True)
            for name in ("completed.ply", "preview.png", "turntable.webp"):
                (folder / name).write_text(row["id"])
    (tmp_path / "local/other/preview.png").write_text("another")
    (tmp_path / "local/lost/completed.ply").unlink()
    found = _row(Options(tmp_path), tmp_path / "local", rows, 1.0)
    assert found["differ"] == ["other/preview.png", "lost/completed.ply"]
    (tmp_path / "local/.batch/work").mkdir(parents=True)
    ledger = Ledger(tmp_path / "local/.batch/ledger.jsonl")
    for name in ("same", "other", "other"):
        ledger.add(Row(name, "finished"))
    ledger.add(Row("lost", "failed"))
    ledger.close()
    assert _twice(tmp_path / "local", rows) == {"wrong": ["other", "lost"], "left_over": []}
