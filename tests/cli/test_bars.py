"""Bars say how far a job is, on standard error."""

import pytest

from gscomplete.cli.bars import progress_bar


@pytest.mark.parametrize("count", ["{task.completed:,.0f}/{task.total:,.0f}", None])
def test_a_bar_says_title_count_and_what_follows(capsys, count):
    with progress_bar("making", "{task.fields[state]}", count=count) as bar:
        task = bar.add_task("things", total=2000, state="")
        bar.update(task, completed=1000, state="half of it")
    told = capsys.readouterr()
    assert told.out == ""
    assert all(text in told.err for text in ("making", "ETA", "half of it"))
    assert ("1,000/2,000" in told.err) == (count is not None)
