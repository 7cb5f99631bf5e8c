"""Parts to choose settings on are not those of the benchmark, and turning keeps objects whole."""

import dataclasses
from itertools import pairwise

import torch

from gscomplete.views import up_rotation
from recipes.real_objects.catalogue import BoxCut, PlaneCut, ScanCut
from recipes.real_objects.compare import OBJECTS
from recipes.real_objects.load import RealObject, cut_object
from recipes.real_objects.validation import parts, side_taken_away_deg, table, turned_object
from tests.recipes.real_objects.test_real_objects import box_splats


def test_parts_are_three_of_every_object_that_the_benchmark_leaves_alone() -> None:
    found = parts()
    of = [part.name.rsplit("-", 1)[0] for part in found]
    assert len({part.name for part in found}) == len(found) == 3 * len(set(of)) == 45
    assert not set(of) & set(OBJECTS)
    assert len({repr(part.cut) for part in found}) > 40


def test_slight_parts_lack_little_the_last_of_each_nothing() -> None:
    found = parts(slight=True)
    assert [part.name for part in found] == [part.name for part in parts()]
    whole = box_splats("Y")
    for part in found[2::3]:
        assert cut_object(whole, dataclasses.replace(part, up="Y")).kept == len(whole)
    for part, sides in zip(found, [4, 3, 0] * 15, strict=True):
        assert isinstance(part.cut, ScanCut) == (sides > 0)
        if isinstance(part.cut, ScanCut):
            gaps = {round((b - a) % 360, 3) for a, b in pairwise(part.cut.from_deg)}
            assert gaps == {360 / sides}
            assert len(part.cut.from_deg) == sides


def test_scans_and_boxes_take_the_far_side_away() -> None:
    assert side_taken_away_deg(PlaneCut(30.0)) == 30.0
    assert side_taken_away_deg(ScanCut((30.0, 60.0))) == 210.0
    assert side_taken_away_deg(BoxCut((-0.5, -0.5, -0.5), (0.0, 0.5, 0.5))) == 180.0


def test_a_turned_object_stands_as_before_and_keeps_its_part() -> None:
    whole = box_splats("Y")
    part = whole.select(torch.arange(len(whole)) % 3 == 0)
    item = RealObject("box", "a box", "Y", part, whole, "every third")
    turned = turned_object(item, 4)
    assert turned.complete is not None
    rotation = up_rotation("Y").double()
    before, after = (s.means.double() @ rotation.T for s in (whole, turned.complete))
    torch.testing.assert_close(after[:, 2], before[:, 2], atol=1e-4, rtol=0)
    angle = torch.atan2(after[:, 1], after[:, 0]) - torch.atan2(before[:, 1], before[:, 0])
    angle_deg = torch.rad2deg(torch.atan2(angle.sin(), angle.cos()))
    assert 15.0 <= float(angle_deg.mean()) <= 75.0
    assert float(angle_deg.std()) < 1e-3
    assert torch.equal(turned.partial.means, turned.complete.means[::3])


def test_the_table_shows_parts_and_means() -> None:
    row = {"silhouette_iou": 0.5, "hidden_iou": 0.25, "hidden_color_psnr_db": None, "seconds": 2.0}
    text = table({"a-0": row, "a-1": {**row, "silhouette_iou": 1.0}})
    assert "a-1" in text
    assert "0.7500 over 2" in text.splitlines()[2]
    assert "hidden_color_psnr_db  unavailable over 0" in text
    again = table({"a-0": row, "a-1": {**row, "hidden_color_psnr_db": 16.0}})
    assert "16.0000 over 1" in again  # what is unknown is left out, not counted as nothing
