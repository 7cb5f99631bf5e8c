"""Means, intervals and tables of rows with known numbers."""

import csv
import io
import random

from gscomplete.evaluate.rows import MEASURES, Row
from gscomplete.evaluate.tables import compared_rows, csv_text, latex, markdown, mean_of

ROWS = [
    Row("ours", "cup", "mesh", {"e_color_v": 0.001, "silhouette_iou": 0.75}, 2.5),
    Row("ours", "box", "lidar", {"e_color_v": 0.002, "silhouette_iou": None}),
    Row("other_1", "cup", "mesh", {"e_color_v": 0.1, "silhouette_iou": 0.8}),
]


def test_a_mean_is_over_the_objects_that_have_the_number():
    mean = mean_of(ROWS[:2], "e_color_v")
    assert mean is not None
    assert (mean.value, mean.count) == (0.0015, 2)
    assert 0.001 <= mean.low < mean.value < mean.high <= 0.002
    iou = mean_of(ROWS[:2], "silhouette_iou")
    assert iou is not None
    assert (iou.value, iou.low, iou.high, iou.count) == (0.75, 0.75, 0.75, 1)
    assert mean_of(ROWS, "clip") is None


def test_the_order_of_rows_changes_no_number():
    rows = [Row("a", str(k), None, {"e_color_v": 0.1 * k**0.5}) for k in range(9)]
    shuffled = random.Random(1).sample(rows, len(rows))
    assert mean_of(rows, "e_color_v") == mean_of(shuffled, "e_color_v")


def test_compared_rows_are_of_objects_that_all_methods_have():
    assert [(row.method, row.object) for row in compared_rows(ROWS)] == [
        ("ours", "cup"), ("other_1", "cup")
    ]  # fmt: skip


def test_markdown_has_a_table_by_subset_the_best_in_bold_and_every_object():
    text = markdown(ROWS, per_object=True)
    assert [line for line in text.splitlines() if line.startswith("**")] == [
        "**all**", "**with every method**", "**lidar**", "**mesh**"
    ]  # fmt: skip
    assert "| ours | 2 | **0.00150** (0.00100 to 0.00200) | 0.750 |" in text
    assert "| other_1 | 1 | 0.10000 | **0.800** |" in text
    assert "| box | lidar | ours | 0.00200 | - |" in text
    assert "S_CLIP" not in text  # nobody has it


def test_nothing_is_best_among_methods_without_a_common_object():
    rows = [Row(name, name, None, {"e_color_v": 0.1 * k}) for k, name in enumerate("ab", 1)]
    assert "| 0.10000 |" in markdown(rows)
    assert "**0." not in markdown(rows)


def test_latex_compiles_in_form():
    text = latex(ROWS)
    assert r"\begin{tabular}{lrcc}" in text
    assert r"ours & 2 & \textbf{0.00150} & 0.750 \\" in text
    assert r"other\_1 & 1 & 0.10000 & \textbf{0.800} \\" in text
    for line in text.splitlines():
        if "&" in line and "multicolumn" not in line:
            assert line.count(" & ") == 3


def test_csv_holds_every_number_exactly():
    rows = list(csv.DictReader(io.StringIO(csv_text(ROWS))))
    assert [row["object"] for row in rows] == ["cup", "box", "cup"]
    assert float(rows[0]["e_color_v"]) == 0.001
    assert (rows[0]["seconds"], rows[1]["seconds"], rows[1]["silhouette_iou"]) == ("2.5", "", "")
    assert set(rows[0]) == {"method", "object", "subset", "seconds", *(m.name for m in MEASURES)}
