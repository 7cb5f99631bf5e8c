"""The page holds everything, and no text of a user becomes markup."""

import base64
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from gscomplete.cli.report import ReportOptions, run
from gscomplete.errors import UserError
from gscomplete.evaluate.pictures import error_picture
from gscomplete.report.packed_splats import unpacked
from gscomplete.report.page import write_page
from gscomplete.views import ObjectFrame
from tests.builders.folders import write_object_folder, write_run_folder
from tests.builders.objects import ball, halves

FRAME = ObjectFrame("Y", (0.5, 1.0, 0.0), 2.0)
SMALL = {"views": 2, "truth_views": 2, "size_px": 32}


def data_of(page: Path) -> dict:
    text = page.read_text(encoding="utf-8")
    found = re.search(r'<script id="data" type="application/json">(.*?)</script>', text, re.S)
    assert found is not None
    return json.loads(found[1])


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("report")
    front, back = halves(ball(1500, 0.5))
    partial = front.__class__(
        FRAME.file_from_object.apply(front.means), front.quaternions, front.scales * 2,
        front.opacities, front.sh,
    )  # fmt: skip
    folder = write_object_folder(
        root / "cup", partial, prompt="</script><b>a cup</b>", frame=FRAME, frame_origin="given"
    )
    write_run_folder(root / "run", folder, back)
    out = root / "page.html"
    assert run(ReportOptions((root / "run",), out=out, title="A & <B>", **SMALL)) == 0
    return out


def test_the_page_holds_pictures_splats_numbers_and_notes(page):
    data = data_of(page)
    (card,) = data["cards"]
    assert card["prompt"] == "</script><b>a cup</b>"
    assert card["notes"] == ["a note <of> the run"]
    assert card["sources"] == {"prompt": "object.json"}
    assert card["timings"]["optimise_s"] == 2.0
    assert 0 <= card["values"]["e_color_v"] < 0.1
    shown = [unpacked(splats) for splats in (data["inputs"][card["input"]], card["added"])]
    assert sum(len(splats["means"]) for splats in shown) == 1500
    assert card["holds_input"]
    kind, picture = card["picture"].split(",")
    assert kind == "data:image/webp;base64"
    assert Image.open(io.BytesIO(base64.b64decode(picture))).size == (528, 352)
    assert [mean["method"] for mean in data["means"]] == ["run"]


def test_nothing_is_fetched_and_no_text_ends_an_element(page):
    text = page.read_text(encoding="utf-8")
    assert "http://" not in text
    assert "https://" not in text
    assert "<b>a cup" not in text
    assert "<title>A &amp; &lt;B></title>" in text
    assert text.count("</script>") == 3


def test_thirty_nine_objects_make_a_small_page(page, tmp_path):
    """Of six methods a page is below 40 MB with the splats that the command puts in."""
    card = data_of(page)["cards"][0]
    most = ReportOptions().most_splats
    splats = {"count": most, "data": "A" * 23 * most}
    cards = [
        card | {"input": splats | {"object": number}, "added": splats}
        for number in range(39)
        for _ in range(6)
    ]
    write_page(tmp_path / "p.html", "many", [], cards)
    assert (tmp_path / "p.html").stat().st_size < 40 * 2**20
    assert len(data_of(tmp_path / "p.html")["inputs"]) == 39


def test_errors_are_drawn_where_p_is():
    grey, red = torch.full((8, 8, 3), 0.5), torch.full((8, 8, 3), 0.5)
    red[:, :4] = 0.9
    mask = torch.zeros(8, 8)
    mask[:4] = 1.0
    picture = np.asarray(error_picture(red, grey, mask))
    assert picture[0, 6].tolist() == [255, 255, 255]  # P, and the same
    assert picture[0, 0].tolist() == [204, 13, 13]  # P, and very different
    assert picture[7, 0].tolist() == [199, 199, 199]  # not P


def test_numbers_of_splats_are_checked(tmp_path):
    with pytest.raises(UserError, match="--most-splats: expected 100 to 1,000,000, found 3"):
        run(ReportOptions((tmp_path,), most_splats=3))
    with pytest.raises(UserError, match=r"--out: expected a file name ending in \.html"):
        run(ReportOptions((tmp_path,), out=tmp_path / "completed.ply"))


def test_names_that_are_no_text_are_shown(tmp_path):
    """As of a run whose input has such a name."""
    inputs = {"means": ""}
    card = {"prompt": "\udcff cup", "notes": ["n\udcff.ply"], "input": inputs}
    write_page(tmp_path / "page.html", "n\udcff", [], [card])
    assert "<title>n\ufffd</title>" in (tmp_path / "page.html").read_text(encoding="utf-8")
    assert data_of(tmp_path / "page.html")["cards"][0] == card | {"input": 0}
