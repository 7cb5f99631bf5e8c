"""``gscomplete evaluate`` on made-up objects and runs with known answers."""

import dataclasses
import json
import shutil
from pathlib import Path

import pytest
import torch

from gscomplete.cli.evaluate import EvaluateOptions, named, run, write_tables
from gscomplete.errors import UserError
from gscomplete.evaluate import perceptual
from gscomplete.evaluate.rows import Row
from gscomplete.splats import concatenate, read_splats, write_splats
from gscomplete.splats.transform import transform_splats
from gscomplete.views import ObjectFrame, ViewDistribution
from tests.builders.folders import write_object_folder, write_run_folder
from tests.builders.objects import ball, halves

SMALL = {"views": 2, "truth_views": 4, "size_px": 48}
FRAME = ObjectFrame("Y", (0.5, 1.0, 0.0), 2.0)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    """Two objects; of the method ``good`` runs of both, of ``other`` a file of one of them."""
    root = tmp_path_factory.mktemp("data")
    front, back = halves(ball(1500, 0.5))
    in_file = [transform_splats(s, FRAME.file_from_object) for s in (front, back)]
    for name, subset in (("cup", "mesh"), ("jug", "lidar")):
        folder = write_object_folder(
            root / "open" / name, in_file[0], concatenate(in_file), subset=subset, frame=FRAME,
            frame_origin="truth", views=ViewDistribution(0.0, 10.0, 20.0, 5.0),
        )  # fmt: skip
        write_run_folder(root / "good" / name, folder, back)
    (root / "other").mkdir()
    write_splats(root / "other" / "cup.ply", in_file[0])  # P alone: nothing was completed
    return root


def rows_of(capsys, **options) -> tuple[int, dict]:
    code = run(EvaluateOptions(json=True, **SMALL, **options))
    content = json.loads(capsys.readouterr().out)
    return code, {(row["method"], row["object"]): row for row in content["rows"]} | {
        "failures": content["failures"]
    }


def test_a_run_with_the_true_back_keeps_p_and_meets_the_truth(dataset, capsys):
    code, rows = rows_of(capsys, paths=(dataset / "good/cup",))
    assert code == 0
    values = rows["cup", "cup"]["values"]
    assert 0 < values["e_color_c"] < 2e-3  # the back shines through gaps of P
    assert 0 < values["e_depth_v"] < 0.1
    assert values["silhouette_iou"] == 1.0
    assert values["silhouette_missed"] == values["silhouette_excess"] == 0.0
    assert values["hidden_psnr_db"] == 100.0
    assert values["hidden_ssim"] == pytest.approx(1.0)
    assert values["haarpsi_truth"] == pytest.approx(1.0, abs=1e-6)
    assert (values["chamfer"], values["f_score_1"]) == (pytest.approx(0.0, abs=1e-6), 1.0)
    assert rows["cup", "cup"]["seconds"] == 3.5
    assert rows["cup", "cup"]["values"]["clip"] is None
    assert "clip" in rows["cup", "cup"]["unavailable"]


def test_a_dataset_is_measured_method_by_method(dataset, capsys, tmp_path):
    code, rows = rows_of(
        capsys,
        dataset=dataset / "open",
        runs=(f"ours={dataset / 'good'}", str(dataset / "other")),
        csv=tmp_path / "t.csv",
        markdown=tmp_path / "t.md",
        latex=tmp_path / "t.tex",
    )
    assert code == 1
    assert rows.pop("failures") == ["other: jug: no finished completion"]
    assert set(rows) == {("ours", "cup"), ("other", "cup"), ("ours", "jug")}
    alone = rows["other", "cup"]["values"]
    assert alone["e_color_v"] == alone["e_depth_v"] == 0.0
    assert alone["haarpsi_v"] == pytest.approx(1.0, abs=1e-6)
    assert alone["silhouette_missed"] > 0.1
    assert (alone["silhouette_excess"], alone["f_score_3"]) == (0.0, 0.0)
    assert "| ours | 2 |" in (tmp_path / "t.md").read_text()
    assert "other & 1 &" in (tmp_path / "t.tex").read_text()
    assert len((tmp_path / "t.csv").read_text().splitlines()) == 4


def test_tables_show_names_that_are_no_text(tmp_path):
    write_tables([Row("n\udcff", "cup", None, {})], tmp_path / "t.csv", tmp_path / "t.md", None)
    assert all("n\ufffd" in path.read_text(encoding="utf-8") for path in tmp_path.iterdir())


def test_what_is_kept_is_measured_once_and_again_when_a_file_changes(dataset, capsys, tmp_path):
    asked = {"dataset": dataset / "open", "runs": (f"good={tmp_path / 'runs'}",)}
    shutil.copytree(dataset / "good", tmp_path / "runs")
    _, first = rows_of(capsys, keep=tmp_path / "kept", **asked)
    kept = tmp_path / "kept/good/jug.json"
    content = json.loads(kept.read_text())
    content["row"]["values"]["e_color_v"] = 0.5
    kept.write_text(json.dumps(content))
    code, again = rows_of(capsys, keep=tmp_path / "kept", **asked)
    assert code == 0
    assert again["good", "jug"]["values"]["e_color_v"] == 0.5
    assert again["good", "cup"] == first["good", "cup"]
    with (tmp_path / "runs/jug/run.json").open("a") as stream:
        stream.write(" ")
    _, changed = rows_of(capsys, keep=tmp_path / "kept", **asked)
    assert changed["good", "jug"] == first["good", "jug"]
    kept.write_text("{")
    _, mended = rows_of(capsys, keep=tmp_path / "kept", **asked)
    assert mended == first


def test_what_is_kept_is_measured_again_when_weights_of_a_metric_arrive(
    dataset, capsys, tmp_path, monkeypatch
):
    asked = {"dataset": dataset / "open", "runs": (f"good={dataset / 'good'}",)}
    _, first = rows_of(capsys, keep=tmp_path / "kept", **asked)
    kept = tmp_path / "kept/good/jug.json"
    kept.write_text(kept.read_text().replace('"unavailable": {', '"unavailable": {"x": "old", '))
    _, again = rows_of(capsys, keep=tmp_path / "kept", **asked)
    assert "x" in again["good", "jug"]["unavailable"]
    monkeypatch.setattr(perceptual, "found_here", lambda: ("lpips",))
    assert rows_of(capsys, keep=tmp_path / "kept", **asked)[1] == first


def test_the_order_of_splats_changes_nothing(dataset, capsys, tmp_path):
    """To the rounding of sums and to depths that differ by less than float32 resolves."""
    front, back = halves(ball(1500, 0.5))
    turned = back.select(torch.randperm(len(back), generator=torch.Generator().manual_seed(3)))
    write_run_folder(tmp_path / "turned", dataset / "open/cup", turned)
    _, rows = rows_of(capsys, paths=(dataset / "good/cup", tmp_path / "turned"))
    one, two = rows["cup", "cup"]["values"], rows["turned", "cup"]["values"]
    for name, value in one.items():
        assert two[name] == (value if value is None else pytest.approx(value, rel=1e-5, abs=1e-7))
    assert len(front) + len(back) == 1500


def test_a_file_needs_its_object(dataset, capsys):
    file = dataset / "other/cup.ply"
    with pytest.raises(UserError, match="--object: expected the folder"):
        run(EvaluateOptions(paths=(file,)))
    code, rows = rows_of(capsys, paths=(file,), object=dataset / "open/cup")
    assert code == 0
    assert rows["cup", "cup"]["values"]["e_color_c"] == 0.0


def test_a_run_of_another_part_is_refused(dataset, tmp_path):
    front, _ = halves(ball(1500, 0.5))
    other = write_object_folder(tmp_path / "other", front.select(torch.arange(20)))
    with pytest.raises(UserError, match="with 20 splats, found one of"):
        run(EvaluateOptions(paths=(dataset / "good/cup",), object=other))
    assert len(read_splats(other / "partial.ply").splats) == 20


def test_a_run_whose_first_splats_are_not_the_objects_is_refused(dataset, tmp_path):
    front, _ = halves(ball(1500, 0.5))
    other = write_object_folder(
        tmp_path / "other", dataclasses.replace(front, means=front.means + 0.01), frame=FRAME
    )
    with pytest.raises(UserError, match="completes another part, or was changed"):
        run(EvaluateOptions(paths=(dataset / "good/cup",), object=other))


def test_a_result_that_was_changed_is_refused(dataset, tmp_path):
    _, back = halves(ball(1500, 0.5))
    run_folder = write_run_folder(
        tmp_path / "run", dataset / "open/cup", back, result={"new_splats": len(back)}
    )
    path = run_folder / "completed.ply"
    splats = read_splats(path).splats
    fainter = dataclasses.replace(splats, opacities=splats.opacities * 0.9)
    for changed, message in (
        (fainter, "completes another part, or was changed"),
        (splats.select(torch.arange(len(splats) - 1)), r"new splats, as run\.json says, found"),
    ):
        write_splats(path, changed)
        with pytest.raises(UserError, match=message):
            run(EvaluateOptions(paths=(run_folder,)))


def test_another_systems_result_that_is_elsewhere_is_doubtful(dataset, capsys, tmp_path):
    moved = read_splats(dataset / "good/cup/completed.ply").splats
    write_splats(tmp_path / "a.ply", moved)
    write_splats(tmp_path / "b.ply", dataclasses.replace(moved, means=moved.means + 10))
    for name, count in (("a", 0), ("b", 1)):
        options = EvaluateOptions(
            paths=(tmp_path / f"{name}.ply",), object=dataset / "open/cup", json=True, **SMALL
        )
        assert run(options) == 0
        said = capsys.readouterr()
        assert said.err.count("only 0% of P's splats") == count
        (row,) = json.loads(said.out)["rows"]
        assert len(row["notes"]) == count


def test_a_run_whose_object_has_gone_says_that_nothing_is_compared(dataset, capsys, tmp_path):
    _, back = halves(ball(1500, 0.5))
    shutil.copytree(dataset / "open/cup", tmp_path / "cup")
    write_run_folder(tmp_path / "run", tmp_path / "cup", back)
    shutil.rmtree(tmp_path / "cup")
    assert run(EvaluateOptions(paths=(tmp_path / "run",), json=True, **SMALL)) == 0
    said = capsys.readouterr()
    assert f"{tmp_path / 'cup'}: the object's folder is not there" in said.err
    assert json.loads(said.out)["rows"][0]["values"]["silhouette_iou"] is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "either run folders"),
        ({"paths": (Path("a"),), "dataset": Path("b")}, "either run folders"),
        ({"paths": (Path("a"),), "runs": ("b",)}, "--runs: expected together with --dataset"),
        ({"paths": (Path("a"),), "keep": Path("b")}, "--keep: expected together with --dataset"),
        ({"dataset": Path("b")}, "--runs: expected at least one"),
        ({"dataset": Path("b"), "runs": ("nowhere",)}, "nowhere: --runs: expected a folder"),
        ({"dataset": Path("b"), "runs": ("x=a", "x=b")}, "a name for each"),
        ({"paths": (Path("a"),), "size_px": 8}, "--size-px: expected 32 to 4096"),
        ({"paths": (Path("a"), Path("b"), Path("a"))}, "a: expected each completion once"),
        ({"paths": (Path("a"),), "csv": Path("a.ply")}, "--csv: expected a file name ending in"),
        ({"paths": (Path("a"),), "markdown": Path("a.csv")}, "--markdown: expected a file name"),
        ({"paths": (Path("a"),), "latex": Path("a")}, "--latex: expected a file name ending in"),
        ({"paths": (Path("a"),), "csv": Path("no/a.csv")}, "--csv: no/a.csv: expected a folder"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, message):
    with pytest.raises(UserError, match=message):
        run(EvaluateOptions(**options))


def test_names():
    assert named("ours=runs/a") == ("ours", Path("runs/a"))
    assert named("runs/fast") == ("fast", Path("runs/fast"))
    assert named("other/cup.ply") == ("cup", Path("other/cup.ply"))
    assert named("a/b=c") == ("b=c", Path("a/b=c"))
