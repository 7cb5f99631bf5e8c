"""``gscomplete weights`` as a user runs it, in this process."""

import importlib.util
import json

import pytest

pytest.importorskip("diffusers", reason="the extra gscomplete[mvdream] is not installed")
pytest.importorskip("transformers", reason="the extra gscomplete[mvdream] is not installed")

from gscomplete.cli import main
from gscomplete.priors.latent.text import CACHE_VARIABLE
from tests.builders.tiny_mvdream import write_folder, write_original


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "home"))
    return tmp_path / "home/weights/mvdream"


def listed(capsys, *more: str) -> tuple[int, dict]:
    code = main(["weights", "list", "--json", *more])
    entries = json.loads(capsys.readouterr().out)["priors"]
    return code, {entry["prior"]: entry for entry in entries}


def test_lists_what_is_missing_and_what_is_there(home, capsys):
    code, entries = listed(capsys)
    assert code == 0
    assert entries["embedded"]["state"] == "ready"
    assert entries["mvdream"]["state"] == "missing"
    assert "OpenRAIL" in entries["mvdream"]["note"]
    home.parent.mkdir(parents=True)
    write_folder(home)
    assert listed(capsys)[1]["mvdream"]["state"] == "ready"
    assert main(["weights", "list"]) == 0
    assert "folder" in capsys.readouterr().out


@pytest.mark.parametrize("lacking", ["diffusers", "transformers"])
@pytest.mark.parametrize("more", [(), ("--verify",)])
def test_without_packages_weights_are_found_and_not_called_damaged(
    home, capsys, monkeypatch, lacking, more
):
    home.parent.mkdir(parents=True)
    write_folder(home)
    real = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == lacking else real(name)
    )
    code, entries = listed(capsys, *more)
    assert code == 0
    assert entries["mvdream"]["state"] == "found"
    assert lacking in entries["mvdream"]["note"]


def test_converts_and_verifies(home, tmp_path, capsys):
    source = write_original(tmp_path)
    assert main(["weights", "convert", str(source), str(home), "--storage", "float16"]) == 0
    assert "written" in capsys.readouterr().out
    assert listed(capsys, "--verify")[1]["mvdream"]["state"] == "ready"
    path = home / "unet.safetensors"
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(bytes(data))
    code, entries = listed(capsys, "--verify")
    assert code == 1
    assert entries["mvdream"]["state"] == "damaged"
    assert main(["weights", "convert", str(source), str(home)]) == 2
    assert "does not exist yet" in capsys.readouterr().err


def test_bad_sources_are_named(home, tmp_path, capsys):
    assert main(["weights", "convert", str(tmp_path / "no.pt"), str(home)]) == 2
    assert "no.pt" in capsys.readouterr().err
    with pytest.raises(SystemExit) as caught:
        main(["weights", "fetch", "something"])
    assert caught.value.code == 2


def test_a_manifest_that_names_no_digests_is_damaged(home, tmp_path, capsys):
    source = write_original(tmp_path)
    assert main(["weights", "convert", str(source), str(home), "--storage", "float16"]) == 0
    capsys.readouterr()
    (manifest,) = (path for path in home.glob("*.json") if "files" in json.loads(path.read_text()))
    content = json.loads(manifest.read_text())
    content["files"]["unet"] = {}
    manifest.write_text(json.dumps(content))
    code, entries = listed(capsys, "--verify")
    assert (code, entries["mvdream"]["state"]) == (1, "damaged")
    assert "unet" in entries["mvdream"]["note"]
