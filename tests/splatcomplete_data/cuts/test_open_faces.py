"""A crop says where its box cuts through the object, and not where the object merely rests."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from gscomplete.splats import write_splats
from splatcomplete_data.cli import main
from splatcomplete_data.cuts.boxes import CropBox
from splatcomplete_data.cuts.open_faces import describe_cuts, faces_cut_through
from tests.builders.objects import round_splats


def column(low: float, high: float, radius: float = 0.3) -> NDArray[np.float64]:
    """Points of an upright column's side and of its two ends."""
    draw = np.random.default_rng(0)
    turn = draw.uniform(0, 2 * np.pi, 20_000)
    side = np.stack([radius * np.cos(turn), radius * np.sin(turn), draw.uniform(low, high, 20_000)])
    out = radius * np.sqrt(draw.uniform(0, 1, 4000))
    turn = turn[:4000]
    height = np.where(draw.uniform(size=4000) < 0.5, low, high)
    ends = np.stack([out * np.cos(turn), out * np.sin(turn), height])
    return np.concatenate([side.T, ends.T])


def floor(height: float, size: float = 2.0) -> NDArray[np.float64]:
    draw = np.random.default_rng(1)
    places = draw.uniform(-size, size, (60_000, 2))
    return np.concatenate([places, draw.normal(height, 0.003, (60_000, 1))], axis=1)


BOX = CropBox((0.0, 0.0, 0.0), (0.5, 0.5, 1.0))


@pytest.mark.parametrize(
    ("low", "high", "faces"),
    [(-0.9, 0.9, ()), (-0.9, 1.5, ("+z",)), (-1.5, 1.5, ("+z", "-z"))],
)
def test_faces_that_the_object_passes_are_named(low, high, faces) -> None:
    assert faces_cut_through(column(low, high), BOX) == faces


def test_a_floor_below_is_not_the_object() -> None:
    points = np.concatenate([column(-1.0, 0.9), floor(-1.01)])
    assert faces_cut_through(points, BOX) == ()


def test_axes_are_the_boxs_own() -> None:
    """A quarter turn about z: the box's y axis is the file's -x axis."""
    turned = CropBox((0.0, 0.0, 0.0), (0.5, 1.0, 0.5), (0.5**0.5, 0.0, 0.0, 0.5**0.5))
    lying = column(-0.9, 1.5)[:, [2, 1, 0]]
    assert faces_cut_through(lying, turned) == ("-y",)


def test_haze_and_several_boxes_say_nothing() -> None:
    splats = round_splats(torch.from_numpy(column(-0.9, 1.5)).float())
    (line,) = describe_cuts(splats, [BOX])
    assert "cuts through splats at its +z face" in line
    faint = round_splats(splats.means, opacity=0.2)
    assert describe_cuts(faint, [BOX]) == ()
    assert describe_cuts(splats, [BOX, BOX]) == ()
    assert describe_cuts(splats, []) == ()
    assert describe_cuts(splats.select(torch.arange(0)), [BOX]) == ()


def test_crop_tells_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    splats = round_splats(torch.from_numpy(column(-0.9, 1.5)).float(), scale=0.02)
    write_splats(tmp_path / "scene.ply", splats)
    asked = [str(tmp_path / "scene.ply"), "--box=0,0,0,0.5,0.5,1", "--up", "Z"]
    assert main(["crop", *asked, "--prompt", "a column", "--out", str(tmp_path / "part")]) == 0
    assert "cuts through splats at its +z face" in capsys.readouterr().out
    record = json.loads((tmp_path / "part/object.json").read_text())
    assert any("cuts through" in note for note in record["notes"])
