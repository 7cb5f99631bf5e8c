"""Parts to choose settings on are not those of the benchmark, and turning keeps objects whole."""

import dataclasses
from itertools import pairwise
from pathlib import Path

import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.views import up_rotation
from recipes.real_objects.catalogue import BoxCut, PlaneCut, ScanCut
from recipes.real_objects.compare import OBJECTS
from recipes.real_objects.load import RealObject, cut_object
from recipes.real_objects.validation import (
    Options,
    chosen_parts,
    parts,
    random_parts,
    side_taken_away_deg,
    table,
    turned_object,
)
from tests.builders.objects import box


def test_parts_are_three_of_every_object_that_the_benchmark_leaves_alone() -> None:
    found = parts()
    of = [part.name.rsplit("-", 1)[0] for part in found]
    assert len({part.name for part in found}) == len(found) == 3 * len(set(of)) == 45
    assert not set(of) & set(OBJECTS)
    assert len({repr(part.cut) for part in found}) > 40


def test_slight_parts_lack_little_the_last_of_each_nothing() -> None:
    found = parts(slight=True)
    assert [part.name for part in found] == [part.name for part in parts()]
    complete = box("Y")
    for part in found[2::3]:
        assert cut_object(complete, dataclasses.replace(part, up="Y")).kept == len(complete)
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
    complete = box("Y")
    part = complete.select(torch.arange(len(complete)) % 3 == 0)
    item = RealObject("box", "a box", "Y", part, complete, "every third")
    turned = turned_object(item, 40.0)
    assert turned.complete is not None
    rotation = up_rotation("Y").double()
    before, after = (s.means.double() @ rotation.T for s in (complete, turned.complete))
    torch.testing.assert_close(after[:, 2], before[:, 2], atol=1e-4, rtol=0)
    angle = torch.atan2(after[:, 1], after[:, 0]) - torch.atan2(before[:, 1], before[:, 0])
    angle_deg = torch.rad2deg(torch.atan2(angle.sin(), angle.cos()))
    assert float(angle_deg.mean()) == pytest.approx(40.0, abs=1e-3)
    assert float(angle_deg.std()) < 1e-3
    assert torch.equal(turned.partial.means, turned.complete.means[::3])


def test_the_table_shows_parts_and_means() -> None:
    row = {"silhouette_iou": 0.5, "hidden_iou": 0.25, "hidden_color_psnr_db": None, "seconds": 2.0}
    row |= {"view_gave_way": False}
    text = table({"a-0": row, "a-1": {**row, "silhouette_iou": 1.0}})
    assert "a-1" in text
    assert "0.7500 over 2" in text.splitlines()[2]
    assert "hidden_color_psnr_db  unavailable over 0" in text
    again = table({"a-0": row, "a-1": {**row, "hidden_color_psnr_db": 16.0}})
    assert "gave way: 0 of 2" in text
    assert "16.0000 over 1" in again  # what is unknown is left out, not counted as nothing


def test_the_table_tells_what_became_of_input_views() -> None:
    row = {"silhouette_iou": 0.5, "hidden_iou": 0.25, "hidden_color_psnr_db": None, "seconds": 2.0}
    moved = {"view_gave_way": True, "truth_hides_from_guessed_view": 0.6}
    better, worse = ({**row, **moved, "truth_hides_from_view": share} for share in (0.2, 0.8))
    text = table({"a": better, "b": worse, "c": {**row, "view_gave_way": False}})
    assert "gave way: 2 of 3" in text
    assert "hides from them 0.600, then 0.500; less: 1" in text


def test_random_parts_are_others_for_every_number_and_the_same_again() -> None:
    found = random_parts(4)
    assert found == random_parts(4) == random_parts(5)[:60]
    assert len({entry.name for entry, _ in found}) == len(found) == 60
    assert {type(entry.cut) for entry, _ in found} == {PlaneCut, ScanCut}
    assert len({angle_deg for _, angle_deg in found}) == 60
    assert not {entry.name.rsplit("-", 1)[0] for entry, _ in found} & set(OBJECTS)


def test_turned_parts_have_angles_and_random_ones_their_own() -> None:
    assert {angle for _, angle in chosen_parts(Options(Path()))} == {0.0}
    angles = [angle for _, angle in chosen_parts(Options(Path(), turned=True))]
    assert min(angles) >= 15.0
    assert max(angles) <= 75.0
    assert chosen_parts(Options(Path(), random=2)) == random_parts(2)
    with pytest.raises(UserError, match="without --slight and --turned"):
        chosen_parts(Options(Path(), random=2, turned=True))
