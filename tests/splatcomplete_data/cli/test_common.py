"""What the commands that write an object folder tell at the end."""

import json
import shlex

import pytest
import tyro

from gscomplete.cli.program import Command
from gscomplete.cli.request import given_to
from gscomplete.splats import write_splats
from splatcomplete_data import cli
from splatcomplete_data.objects import read_record
from tests.builders.objects import BALL


@pytest.mark.parametrize("prompt", ['a "ball" of Ann\'s $HOME', "-1 degrees"])
def test_the_line_that_completes_the_part_is_told(tmp_path, capsys, prompt):
    write_splats(tmp_path / "a ball.ply", BALL)
    out = tmp_path / "my part"
    arguments = ["partial", str(tmp_path / "a ball.ply"), "--cut=plane:90", "--up=-Y"]
    arguments += ["--view=-30,10", "--range=40", f"--prompt={prompt}", "--out", str(out)]
    assert cli.main(arguments) == 0
    line = capsys.readouterr().out.splitlines()[-1].removeprefix("complete it: ")
    program, *words = shlex.split(line)
    assert program == "gscomplete"
    options = tyro.cli(Command, args=words)
    assert (options.partial, options.out) == (out, tmp_path / "my part_completed")
    given = given_to(options)
    assert given.partial == out / "partial.ply"
    assert (given.prompt, given.up) == (prompt, "-Y")
    assert (given.view_deg, given.azimuth_range_deg) == ((-30.0, 10.0), 40.0)
    assert (given.center_file, given.size_file) == (None, None)
    assert cli.main([*arguments, "--overwrite", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["complete_command"] == line
    assert "complete_command" not in json.loads((out / "object.json").read_text())


def test_a_complete_object_alone_has_no_such_line(tmp_path, capsys):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box().export(tmp_path / "box.ply")
    arguments = ["mesh", str(tmp_path / "box.ply"), "--count", "500", "--out", str(tmp_path / "o")]
    assert cli.main(arguments) == 0
    assert "complete it" not in capsys.readouterr().out
    assert cli.main([*arguments, "--overwrite", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["complete_command"] is None


def test_a_file_whose_name_is_no_text_becomes_an_object(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_splats("n\udcff.ply", BALL)
    assert cli.main(["partial", "n\udcff.ply", "--cut=plane:90", "--json"]) == 0
    capsys.readouterr().out.encode()
    record = read_record(tmp_path / "n\udcff_object")
    assert (record.id, record.prompt) == ("n\ufffd_object", "n\ufffd")
    assert record.source.file == "n\udcff.ply"


def test_control_characters_of_a_file_name_reach_neither_prompt_nor_terminal(tmp_path, capsys):
    path = tmp_path / "a\x1b[31m\nball.ply"
    write_splats(path, BALL)
    out = tmp_path / "out"
    assert cli.main(["partial", str(path), "--cut=plane:90", "--out", str(out)]) == 0
    assert read_record(out).prompt == "a [31m ball"
    assert cli.main(["crop", str(path), "--box=0,0,0,1,1,.2", "--out", f"{out}\x1b"]) == 2
    told = capsys.readouterr()
    assert "\x1b" not in told.out + told.err
