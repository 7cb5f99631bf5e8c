"""Rows go on only with rows that were made alike."""

import pytest

from gscomplete.completion.settings import CompletionSettings
from gscomplete.errors import UserError
from recipes.results import Results


def test_rows_go_on_where_they_stopped(tmp_path):
    made_with = {"seed": 1, "settings": CompletionSettings()}
    first = Results(tmp_path / "out" / "rows.json", made_with)
    first.rows["a"] = {"iou": 0.5}
    first.save()
    assert Results(tmp_path / "out" / "rows.json", made_with).rows == {"a": {"iou": 0.5}}


def test_rows_of_other_options_are_never_taken_over(tmp_path):
    path = tmp_path / "rows.json"
    Results(path, {"seed": 1, "settings": CompletionSettings()}).save()
    with pytest.raises(UserError, match="another seed: expected 2, found 1"):
        Results(path, {"seed": 2, "settings": CompletionSettings()})
    with pytest.raises(UserError, match=r"another settings\.steps: expected 7, found \d+; "):
        Results(path, {"seed": 1, "settings": CompletionSettings(steps=7)})
    Results(tmp_path / "b.json", {"seed": 1, "flaw": "haze"}).save()
    with pytest.raises(UserError, match="another flaw: expected None, found haze"):
        Results(tmp_path / "b.json", {"seed": 1})
    path.write_text("[]")
    with pytest.raises(UserError, match="expected made_with and rows"):
        Results(path, {"seed": 1})
