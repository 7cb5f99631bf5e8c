"""``convert X out.html``: the page holds the splats, and nothing of it is fetched."""

from pathlib import Path

import numpy as np
import pytest

from gscomplete.report.packed_splats import unpacked
from gscomplete.splats import write_splats
from splatcomplete_data.cli import main
from tests.report.test_page import data_of
from tests.splats.formats.test_any_file import some_splats


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "<b>.ply"
    write_splats(path, some_splats(200))
    return path


def test_a_page_shows_splats_upright(source: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "a.html"
    assert main(["convert", str(source), str(out), "--up", "Y"]) == 0
    said = capsys.readouterr().out
    assert "lost: 8-bit colours, scales and rotations, 16-bit positions, harmonics of" in said
    text = out.read_text()
    assert "http://" not in text
    assert "https://" not in text
    assert "<b>.ply" not in text
    splats = unpacked(data_of(out)["splats"])
    drawn = some_splats(200)
    drawn = drawn.select(drawn.opacities >= 0.02)
    assert len(splats["means"]) == len(drawn)
    # y of the file points up in the page: its z
    order = np.argsort(splats["means"][:, 2])
    assert (np.diff(drawn.means[order, 1].numpy()) > -1e-3).all()


def test_wrong_options_of_a_page_are_refused(source: Path, tmp_path: Path, capsys) -> None:
    assert main(["convert", str(source), str(tmp_path / "a.html"), "--most-splats", "3"]) == 2
    assert "--most-splats: expected 100 to 5,000,000, found 3" in capsys.readouterr().err
