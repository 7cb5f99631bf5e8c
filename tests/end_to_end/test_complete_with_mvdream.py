"""``gscomplete complete --prior PATH`` with a reduced-width MVDream in the published layout."""

import json

import pytest
import torch

pytest.importorskip("diffusers", reason="the extra gscomplete[mvdream] is not installed")
pytest.importorskip("transformers", reason="the extra gscomplete[mvdream] is not installed")

from gscomplete.cli import complete, main
from gscomplete.priors.latent.text import CACHE_VARIABLE
from gscomplete.splats import read_splats
from tests.builders.commands import SAMPLE
from tests.builders.tiny_mvdream import write_original


@pytest.fixture
def arguments(tmp_path, monkeypatch) -> list[str]:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    weights = write_original(tmp_path)
    command = ["complete", str(SAMPLE), "--prompt", "a red mug", "--out", str(tmp_path / "run")]
    return [*command, "--prior", str(weights), "--steps", "1", "--device", "cpu"]


def test_runs_and_records_what_decided_it(arguments, tmp_path, capsys):
    assert main(arguments) == 0, capsys.readouterr().err
    content = json.loads((tmp_path / "run/run.json").read_text())
    identity = content["identity"]
    assert identity["settings"]["mode"] == "distill"
    assert identity["settings"]["timesteps"][0]["low"] == 910.0
    assert identity["settings"]["rescale_about"] == "background"
    assert identity["prior"]["name"] == "mvdream"
    assert identity["prior"]["settings"]["guidance"] == 50.0
    assert len(identity["prior"]["weights"]) == 32
    assert len(list((tmp_path / "cache/prompts").iterdir())) == 2
    completed = read_splats(tmp_path / "run/completed.ply")
    assert completed.n_rows == read_splats(SAMPLE).n_rows + content["result"]["new_splats"]
    assert main([*arguments, "--resume", "--diffusion.loss", "epsilon"]) == 2
    assert "cannot resume with another prior" in capsys.readouterr().err


def test_the_paper_s_settings_are_asked_for_by_name(arguments, tmp_path, capsys):
    assert main([*arguments, "--preset", "paper"]) == 0, capsys.readouterr().err
    settings = json.loads((tmp_path / "run/run.json").read_text())["identity"]["settings"]
    assert settings["timesteps"][0]["low"] == 392.0
    assert settings["rescale_about"] is None  # MVDream's own: about zero


def test_a_full_gpu_is_one_line(arguments, monkeypatch, capsys):
    """Only a run that has begun can be resumed."""

    def full(*_):
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate ...")

    monkeypatch.setattr(complete, "_with_progress", full)
    assert main(arguments) == 4
    begun = capsys.readouterr().err
    assert "--diffusion.memory" in begun
    assert "--resume continues" in begun
    monkeypatch.setattr(complete, "_complete", full)
    assert main(arguments) == 4
    assert "--resume" not in capsys.readouterr().err
