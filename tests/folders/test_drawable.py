"""A file stands for itself, whatever lies beside it; its frame comes from records of ours only."""

import pytest

from gscomplete.errors import UserError
from gscomplete.folders.drawable import drawable_of
from gscomplete.splats import write_splats
from tests.builders.folders import write_object_folder, write_run_folder
from tests.builders.objects import ball


def test_a_result_has_the_frame_of_its_run(tmp_path):
    run = write_run_folder(
        tmp_path / "run", write_object_folder(tmp_path / "cup", ball(20)), ball(30)
    )
    for path in (run, run / "run.json", run / "completed.ply"):
        found = drawable_of(path)
        assert found.file == run / "completed.ply"
        assert found.frame is not None
        assert found.frame.up == "Y"


@pytest.mark.parametrize("content", ["{", "[]", '{"schema": "another program"}'])
def test_a_record_of_another_program_is_no_matter_to_a_file(tmp_path, content):
    (tmp_path / "run.json").write_text(content)
    write_splats(tmp_path / "completed.ply", ball(20))
    found = drawable_of(tmp_path / "completed.ply")
    assert (found.file, found.frame) == (tmp_path / "completed.ply", None)
    with pytest.raises(UserError, match=r"run\.json"):
        drawable_of(tmp_path)
