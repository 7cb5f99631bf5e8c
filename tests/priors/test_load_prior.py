"""What ``--prior`` accepts, and what it says of anything else."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from gscomplete.errors import UserError
from gscomplete.priors import load_prior
from gscomplete.priors.latent.settings import LatentPriorSettings
from gscomplete.priors.latent.text import CACHE_VARIABLE
from gscomplete.priors.mvdream.store import MVDREAM, find_mvdream
from tests.builders.commands import PATIENCE_S


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "home"))
    return tmp_path / "home/weights/mvdream"


def test_missing_weights_are_one_message_with_all_that_is_needed(home):
    with pytest.raises(UserError) as caught:
        load_prior("mvdream")
    message = str(caught.value)
    for part in (MVDREAM.filename, MVDREAM.repository, "4.9 GiB", "OpenRAIL", str(home),
                 "gscomplete weights fetch mvdream", "--prior PATH"):  # fmt: skip
        assert part in message


def test_layouts_are_looked_for_in_order(home):
    home.mkdir(parents=True)
    (home / MVDREAM.filename).touch()
    assert find_mvdream() == home / MVDREAM.filename
    (home / "unet").mkdir()
    (home / "unet/config.json").write_text("{}")
    assert find_mvdream() == home


def test_unknown_priors_are_named(tmp_path):
    with pytest.raises(UserError, match="expected embedded, mvdream, or a file"):
        load_prior("mvdrean")
    with pytest.raises(UserError, match="found none of them"):
        load_prior(str(tmp_path))
    (tmp_path / "weights.pt").write_bytes(b"no")
    with pytest.raises(UserError, match=r"weights\.pt"):
        load_prior(str(tmp_path / "weights.pt"))


def test_knobs_of_latent_priors_are_refused_by_the_embedded_one():
    with pytest.raises(UserError, match="--diffusion"):
        load_prior("embedded", settings=LatentPriorSettings(loss="epsilon"))


def test_without_the_extra_there_is_one_line(home):
    """In a process of its own, where the optional packages cannot be imported."""
    home.mkdir(parents=True)
    code = (
        "import sys\n"
        "for name in ('diffusers', 'transformers'): sys.modules[name] = None\n"
        "from gscomplete.cli import main\n"
        "sys.exit(main(['complete', 'recipes/demo/partial.ply', '--prompt', 'x', '--prior', "
        "sys.argv[1], '--out', sys.argv[2]]))\n"
    )
    path = home / "tiny.safetensors"
    save_file({"a": torch.zeros(1)}, path)
    result = subprocess.run(
        [sys.executable, "-c", code, str(path), str(home / "out")],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        cwd=Path(__file__).resolve().parents[2],
    )
    assert result.returncode == 2, result.stderr
    assert "install the extra gscomplete[mvdream]" in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert not (home / "out").exists()


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("os:getcwd", r"getcwd\(\) \(too many positional arguments\)"),
        ("operator:add", r"add\(a, b, /\) \(missing a required argument: 'b'\)"),
        ("os:name", "str"),
    ],
)
def test_a_function_of_other_arguments_is_named(name, found):
    message = rf"--prior {name}: expected a function of one argument, the device, found {found}"
    with pytest.raises(UserError, match=message):
        load_prior(name)


def test_an_error_within_a_prior_of_ones_own_stays_itself(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "prior_with_a_bug.py").write_text("def make(device):\n    return len(3)\n")
    with pytest.raises(TypeError, match="has no len"):
        load_prior("prior_with_a_bug:make")
