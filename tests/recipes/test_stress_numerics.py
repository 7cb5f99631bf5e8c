"""The rows of the stress table at their small size (``recipes.stress_numerics`` runs all)."""

import json
import math
from pathlib import Path

import pytest

from gscomplete.errors import UserError
from recipes.stress_numerics import splat_rows
from recipes.stress_numerics.__main__ import Options, main, run_row
from recipes.stress_numerics.completion_rows import COMPLETION_ROWS
from recipes.stress_numerics.file_rows import FILE_ROWS
from recipes.stress_numerics.rows import Check, Row
from recipes.stress_numerics.splat_rows import SPLAT_ROWS
from recipes.stress_numerics.view_rows import VIEW_ROWS

ROWS = (*SPLAT_ROWS, *VIEW_ROWS, *FILE_ROWS, *COMPLETION_ROWS)
SLOW = ("threads", "millions", "far-off P", "poisoned prior", "float32", "all opaque")
"""Rows with processes of their own or whole runs, and those that other tests repeat."""


@pytest.mark.parametrize("row", [r for r in ROWS if r.name not in SLOW], ids=lambda row: row.name)
def test_row(row: Row) -> None:
    result = run_row(row, quick=True)
    assert [check for check in result["checks"] if not check["passed"]] == []


def test_a_failed_check_or_an_exception_fails_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    def raises(quick: bool):
        yield Check("fine", 0, 0)
        raise RuntimeError("boom")

    rows = {
        "good": Row("good", "x", lambda quick: iter([Check("a", 0.5, 1)])),
        "bad": Row("bad", "x", lambda quick: iter([Check("b", 2, 1)])),
        "nan": Row("nan", "x", lambda quick: iter([Check("c", math.nan, 1)])),
        "empty": Row("empty", "x", lambda quick: iter([Check("d", 1, 0)])),
        "raises": Row("raises", "x", raises),
    }
    monkeypatch.setattr(splat_rows, "SPLAT_ROWS", tuple(rows.values()))
    assert main(Options(rows=("good",), json=tmp_path / "good.json")) == 0
    for name in ("bad", "nan", "empty", "raises"):
        assert main(Options(rows=(name, "good"), json=tmp_path / "out.json")) == 1
        assert "FAIL" in capsys.readouterr().out
    (result, _) = json.loads((tmp_path / "out.json").read_text())
    assert "boom" in result["checks"][1]["what"]
    with pytest.raises(UserError, match="unheard of"):
        main(Options(rows=("unheard of",)))
