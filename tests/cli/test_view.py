import os
import signal
import subprocess
import sys
import urllib.request

import pytest

from gscomplete.cli import main
from gscomplete.splats import write_splats
from tests.builders.commands import PATIENCE_S
from tests.builders.objects import random_splats


def test_the_command_serves_until_it_is_interrupted(tmp_path):
    pytest.importorskip("viser")
    write_splats(tmp_path / "a.ply", random_splats(50))
    command = [sys.executable, "-m", "gscomplete.cli", "view", str(tmp_path), "--port", "18180"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, preexec_fn=heed_interrupts
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "a: 50 splats\n"
            address = process.stdout.readline().split()[0]
            with urllib.request.urlopen(address, timeout=PATIENCE_S) as page:
                assert page.status == 200
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=PATIENCE_S) == 0
        finally:
            process.kill()
    assert os.listdir(tmp_path) == ["a.ply"]


def heed_interrupts():
    """Undo what a shell does to jobs in the background: they ignore interrupts."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "expected a run folder or splat files"),
        (["nowhere.ply"], "nowhere.ply"),
        (["x.ply", "--port", "0"], "--port: expected 1 to 65535"),
        (["x.ply", "--most-splats", "0"], "--most-splats: expected at least 1"),
    ],
)
def test_errors_end_in_one_line(arguments, message, capsys):
    assert main(["view", *arguments]) == 2
    assert message in capsys.readouterr().err
