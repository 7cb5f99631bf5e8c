"""`--pick` of `crop` and `scan` as commands; the page is tested with the boxes."""

import os
import signal
import subprocess
import sys
import time
import urllib.request

import numpy as np
import pytest

from gscomplete.splats import write_splats
from splatcomplete_data.cli import main
from tests.builders.commands import PATIENCE_S
from tests.builders.objects import random_splats


def test_a_file_that_box_would_not_read_is_refused(tmp_path, capsys):
    write_splats(tmp_path / "scene.ply", random_splats(50))
    for command in ("crop", "scan"):
        assert main([command, str(tmp_path / "scene.ply"), "--pick", "boxes.json"]) == 2
        assert "--pick: expected a file NAME.txt, found 'boxes.json'" in capsys.readouterr().err
        nowhere = str(tmp_path / "nowhere/boxes.txt")
        assert main([command, str(tmp_path / "scene.ply"), "--pick", nowhere]) == 2
        assert "the folder does not exist" in capsys.readouterr().err
        both = ["--pick", str(tmp_path / "boxes.txt"), "--propose"]
        assert main([command, str(tmp_path / "scene.ply"), *both]) == 2
        assert "--pick, --propose: expected one of them, found both" in capsys.readouterr().err


def test_the_page_is_served_until_it_is_interrupted(tmp_path):
    pytest.importorskip("viser")
    np.savetxt(tmp_path / "scan.xyz", np.random.default_rng(0).uniform(-1, 1, (200, 3)))
    arguments = ["scan", str(tmp_path / "scan.xyz"), "--pick", str(tmp_path / "boxes.txt")]
    process = subprocess.Popen(
        [sys.executable, "-m", "splatcomplete_data.cli", *arguments],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    try:
        assert process.stdout is not None
        address = process.stdout.readline().split()[0]
        with urllib.request.urlopen(address, timeout=PATIENCE_S) as page:
            assert page.status == 200
        time.sleep(0.2)  # until it waits
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
    finally:
        process.kill()
    assert not (tmp_path / "boxes.txt").exists()  # nothing was saved
