"""What is said of records of runs that no run wrote."""

import pytest

from gscomplete.errors import UserError
from gscomplete.folders.run_folder import RUN_FILE, read_run_folder


@pytest.mark.parametrize("count", ["1e999", "null", '"many"', "[]"])
def test_a_number_of_splats_that_is_none_is_named(tmp_path, count):
    (tmp_path / RUN_FILE).write_text(f'{{"input": {{"splats": {count}}}, "identity": {{}}}}')
    with pytest.raises(UserError, match=r"run\.json: expected the record of a run"):
        read_run_folder(tmp_path)
