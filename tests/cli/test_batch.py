"""The options of ``gscomplete batch``, and what it prints."""

import json
from pathlib import Path

import pytest

from gscomplete.batch.manifest import Item
from gscomplete.cli import main
from gscomplete.cli.batch_job import CompleteJob, identity_of
from gscomplete.cli.complete_options import HowToComplete
from gscomplete.errors import UserError
from gscomplete.splats import write_splats
from tests.builders.batch_jobs import ToyJob
from tests.builders.folders import write_object_folder
from tests.builders.objects import ball


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Three files, one of them bad, and a job that does not complete anything."""
    for name in ("a", "bad", "c"):
        (tmp_path / "in").mkdir(exist_ok=True)
        (tmp_path / "in" / f"{name}.ply").write_bytes(name.encode())
    (tmp_path / "notes").mkdir()
    monkeypatch.setattr("gscomplete.cli.batch_job.CompleteJob", lambda how: job)
    job = ToyJob(tmp_path / "notes")
    return tmp_path


def batch(folder: Path, *more: str, prompt: tuple[str, ...] = ("--prompt", "a mug")) -> int:
    arguments = ("batch", str(folder / "in"), "--out", str(folder / "runs"), "--workers", "1")
    return main([*arguments, *prompt, *more])


def test_failures_are_told_and_are_the_exit_code(folder, capsys):
    assert batch(folder) == 1
    told = capsys.readouterr().out
    assert "finished: a, 1 new splats" in told
    assert f"failed: bad: {folder}/in/bad.ply: it is bad" in told
    assert "logs of failed objects:" in told
    (folder / "in/bad.ply").unlink()
    assert batch(folder) == 0
    assert "2 objects, 2 of them already finished" in capsys.readouterr().out


def test_json_is_one_object_on_standard_output(folder, capsys):
    assert batch(folder, "--json") == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["objects"], told["counts"]) == (
        3,
        {"finished_before": 0, "finished": 2, "failed": 1},
    )
    assert [row["id"] for row in told["rows"]] == ["a", "bad", "c"]
    assert Path(told["ledger"]).is_file()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--memory", "-1"), "--memory: expected a number of GiB"),
        (("--memory", "1e-10"), "--memory: expected a number of GiB"),
        (("--device", "cuda:abc"), "--device: expected auto, cpu, cuda or cuda:N"),
        (("--ray", "--threads", "-1"), "--threads: expected 1 or more"),
        (("--ray", "--workers", "-1"), "--workers: expected 1 or more"),
        (("--workers", "0"), "--workers: expected 1 or more"),
        (("--retries", "-1"), "--retries: expected 0 or more"),
        (("--view", "nowhere"), "--view: expected AZIMUTH,ELEVATION"),
        (("--ray", "one", "two"), "--ray: expected one address at most"),
        (("--prior", "mvdream:no-such", "--memory", "100000"), "100000.0 GiB of memory"),
    ],
)
def test_wrong_options_are_one_line(folder, capsys, options, message):
    assert batch(folder, *options) == 2
    told = capsys.readouterr().err
    assert message in told
    assert len(told.strip().splitlines()) == 1


def test_objects_without_a_prompt_are_named_before_a_worker_starts(folder, capsys):
    assert batch(folder, prompt=()) == 2
    assert "--prompt: expected a prompt for each object" in (told := capsys.readouterr().err)
    assert "found none for a, bad, c" in told
    assert not (folder / "runs").exists()
    (folder / "in/object.json").write_text("{}")  # may say it
    assert batch(folder, prompt=()) == 1


def test_nothing_but_what_decides_results_is_the_batch_s_identity(tmp_path):
    plain = identity_of(HowToComplete())
    assert identity_of(HowToComplete(device="cpu", checkpoint_every=7)) == plain
    assert identity_of(HowToComplete(preset="fast")) != plain
    (tmp_path / "weights\udcff").write_bytes(b"1")
    first = identity_of(HowToComplete(prior=str(tmp_path)))
    (tmp_path / "weights\udcff").write_bytes(b"2")
    assert identity_of(HowToComplete(prior=str(tmp_path))) != first


def test_a_prior_that_cannot_be_loaded_ends_the_batch(tmp_path):
    from gscomplete.batch.work import SetupError

    job = CompleteJob(HowToComplete(prior=str(tmp_path / "no weights"), device="cpu"))
    with pytest.raises(SetupError, match="no weights"):
        job.make(Item("a", "a.ply"), tmp_path / "a.ply", tmp_path / "out", resume=False)


def test_the_prompt_of_a_batch_is_for_objects_that_have_none(tmp_path, monkeypatch):
    """Options as the job asks with them; a manifest's own prompt counts before the folder's."""
    asked = []

    def noted(options, prior):
        asked.append(options.prompt)
        raise UserError("asked")

    monkeypatch.setattr("gscomplete.cli.request.request_of", noted)
    folder = write_object_folder(tmp_path / "cow", ball(20), prompt="a cow")
    write_splats(tmp_path / "a.ply", ball(20))
    job = CompleteJob(HowToComplete(prompt="a thing", device="cpu"))
    for item, source in (
        (Item("a", "a.ply"), tmp_path / "a.ply"),
        (Item("cow", "cow"), folder),
        (Item("cow", "cow", {"prompt": "a bull"}), folder),
    ):
        with pytest.raises(UserError, match="asked"):
            job.make(item, source, tmp_path / "out", resume=False)
    assert asked == ["a thing", None, "a bull"]
