"""A run folder survives what happens to it, and what cannot go on says why."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from gscomplete.completion import pipeline
from gscomplete.completion.pipeline import Request
from gscomplete.completion.presets import RECONSTRUCT
from gscomplete.completion.run_folder import RUN_FILE, Run, RunRequest, execute, prepare
from gscomplete.completion.settings import CompletionSettings
from gscomplete.errors import UserError
from gscomplete.fitting.step_loop import LOG_FILE
from gscomplete.framing.decide import FramingRequest
from gscomplete.priors.base import FirstGuess
from gscomplete.splats import write_splats
from tests.builders.objects import ball
from tests.builders.priors import GuessingPrior

CHECKPOINT = "checkpoints/latest.safetensors"


BALL = ball(300)
HALF = BALL.select(BALL.means[:, 0] > 0)
QUICK = dataclasses.replace(
    RECONSTRUCT, start="sphere", steps=6, new_splats=50, rounds=2, resolution_px=16
)
NOTHING = FirstGuess(BALL.select(torch.arange(0)), ())
COLORS_ALONE = dataclasses.replace(QUICK, mode="distill", moves="colors")
"""As the embedded prior's ``distill`` moves them."""


def begin(
    folder: Path,
    *,
    resume: bool = False,
    settings: CompletionSettings = QUICK,
    new_only: Path | None = None,
) -> Run:
    write_splats(folder / "p.ply", HALF)
    framing = FramingRequest(view_deg=(0.0, 10.0), center_file=(0.0, 0.0, 0.0), size_file=0.8)
    asked = Request("a ball", dataclasses.replace(settings, checkpoint_every=1), framing)
    request = RunRequest(folder / "p.ply", folder / "out", asked, resume=resume, new_only=new_only)
    return prepare(request, GuessingPrior(BALL, NOTHING))


class Stop(Exception):
    """Ends a run after some steps."""


def stop_after_four(folder: Path, settings: CompletionSettings = QUICK) -> Path:
    """Stop a run after four of six steps."""

    def stop(report) -> None:
        if report.step == 4:
            raise Stop

    with pytest.raises(Stop):
        execute(begin(folder, settings=settings), stop)
    return folder


@pytest.fixture
def stopped(tmp_path: Path) -> Path:
    return stop_after_four(tmp_path)


@pytest.mark.parametrize("settings", [QUICK, COLORS_ALONE])
def test_a_stopped_run_goes_on_to_the_same_bytes(tmp_path: Path, settings) -> None:
    stopped, other = (tmp_path / name for name in ("stopped", "other"))
    for folder in (stopped, other):
        folder.mkdir()
    execute(begin(other, settings=settings), lambda report: None)
    stop_after_four(stopped, settings)
    # the log may hold anything: what it says decides nothing
    log = stopped / "out" / LOG_FILE
    log.write_bytes(b"\xff\xfe{\n" + log.read_bytes()[5:])
    resumed = begin(stopped, resume=True, settings=settings)
    assert resumed.steps.step_number == 4
    execute(resumed, lambda report: None)
    results = [(folder / "out/completed.ply").read_bytes() for folder in (stopped, other)]
    assert results[0] == results[1]


def test_the_time_of_a_resumed_run_is_that_of_all_its_steps(stopped: Path) -> None:
    log = stopped / "out" / LOG_FILE
    lines = [json.loads(line) | {"seconds": 100.0} for line in log.read_text().splitlines()]
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    content = execute(begin(stopped, resume=True), lambda report: None)
    assert 400 < content["timings"]["optimise_s"] < 500  # four steps, and two that take no time
    assert content["result"]["seconds"] > 400


def test_a_run_that_adds_nothing_goes_on_after_its_checkpoint(tmp_path: Path, monkeypatch) -> None:
    def fail(*arguments) -> None:
        raise Stop

    settings = dataclasses.replace(QUICK, start="guess", steps=0)
    with monkeypatch.context() as patched:
        patched.setattr(pipeline, "finish", fail)
        with pytest.raises(Stop):
            execute(begin(tmp_path, settings=settings), lambda report: None)
    resumed = begin(tmp_path, resume=True, settings=settings)
    assert execute(resumed, lambda report: None)["result"]["new_splats"] == 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"step": torch.tensor(-5)}, "step: expected 0 to 6, found -5"),
        ({"value.means": torch.zeros(0, 3)}, "value.means: expected one row a splat"),
        ({"ring.0.color": None}, "ring"),
        ({"ring.0.alpha": torch.zeros(4, 3)}, r"ring\.0\.alpha: expected numbers"),
        ({"ring.0.camera_from_world": None}, r"ring\.0\.camera_from_world"),
        ({"adam.sh.exp_avg": None}, r"adam\.sh\.exp_avg: expected .* found none"),
    ],
)
def test_a_damaged_checkpoint_is_named(stopped: Path, changes, message) -> None:
    path = stopped / "out" / CHECKPOINT
    state = {name: value.clone() for name, value in load_file(path).items()} | changes
    save_file({name: value for name, value in state.items() if value is not None}, path)
    with pytest.raises(UserError, match=rf"latest\.safetensors: .*{message}"):
        begin(stopped, resume=True)


@pytest.mark.parametrize("text", ['{"identity": "no"}', "[]", "{", "\udcff"])
def test_a_damaged_run_file_is_named(stopped: Path, text: str) -> None:
    (stopped / "out" / RUN_FILE).write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(UserError, match=r"run\.json"):
        begin(stopped, resume=True)


def test_what_a_killed_start_leaves_is_no_run(tmp_path: Path) -> None:
    """A kill while the very first run.json is written leaves its temporary file alone."""
    (tmp_path / "out").mkdir()
    (tmp_path / f"out/.{RUN_FILE}.ab12_xyz.json").write_text('{"schema')
    with pytest.raises(UserError, match=r"there is no run\.json; start without --resume"):
        begin(tmp_path, resume=True)
    begin(tmp_path)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {RUN_FILE}
    assert json.loads((tmp_path / "out" / RUN_FILE).read_text())["status"] == "running"


def test_a_file_in_place_of_the_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    with pytest.raises(UserError, match="--out: expected a folder to create, found a file"):
        begin(tmp_path)
    assert (tmp_path / "out").read_text() == "mine"


@pytest.mark.parametrize("name", ["out/completed.ply", "out/../out/new.ply", "link/new.ply"])
def test_new_splats_are_not_written_into_the_run_folder(tmp_path: Path, name: str) -> None:
    """There they would take the place of P and what completes it."""
    (tmp_path / "out").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "out")
    with pytest.raises(UserError, match=r"--new-only: .* expected a file outside the run folder"):
        begin(tmp_path, new_only=tmp_path / name)
    assert not any((tmp_path / "out").iterdir())


def test_a_resumed_run_replaces_its_own_file_of_new_splats_and_no_other(tmp_path: Path) -> None:
    own, other = tmp_path / "new.ply", tmp_path / "other.ply"
    begin(tmp_path, new_only=own)
    for file in (own, other):
        file.write_bytes(b"written")
    with pytest.raises(UserError, match=r"other\.ply: it exists; choose another name"):
        begin(tmp_path, new_only=other, resume=True)
    execute(begin(tmp_path, new_only=own, resume=True), lambda report: None)
    assert own.read_bytes().startswith(b"ply")
    assert other.read_bytes() == b"written"


def test_a_folder_with_something_in_it_is_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/mine.txt").write_text("mine")
    (tmp_path / "p.ply").write_bytes(b"not even read")
    request = RunRequest(tmp_path / "p.ply", tmp_path / "out", Request("a ball", QUICK))
    with pytest.raises(UserError, match="the output folder exists and is not empty"):
        prepare(request, GuessingPrior(BALL, NOTHING))


def test_a_run_records_what_its_bytes_depend_on_and_tells_of_changes(stopped: Path) -> None:
    path = stopped / "out" / RUN_FILE
    content = json.loads(path.read_text())
    assert content["versions"]["torch_threads"] == torch.get_num_threads()
    content["versions"]["torch"] = "1.0"
    path.write_text(json.dumps(content))
    run = begin(stopped, resume=True)
    assert any("begun with torch 1.0 (now" in note for note in run.notes)
    finished = execute(run, lambda report: None)
    assert any("begun with torch 1.0 (now" in note for note in finished["notes"])
