from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.splats import Splats, concatenate, read_splats, write_splats
from splatcomplete_data.cli import main
from splatcomplete_data.cuts.boxes import CropBox, box_text, inside_boxes, parse_box
from splatcomplete_data.multiview.box_picture import box_corners
from splatcomplete_data.multiview.crop import kept_rows, write_rows
from splatcomplete_data.multiview.propose_box import Focus, focus_of_splats, propose_box
from splatcomplete_data.multiview.reconstruct import SCHEMA
from splatcomplete_data.multiview.scene import nearest_axis, read_scene
from tests.builders import captures

TURN = (0.9, 0.1, -0.3, 0.2)


def table(height: float = -0.6, count: int = 1500) -> Splats:
    """A flat square of large splats below the ball, 4 x 4."""
    generator = torch.Generator().manual_seed(3)
    flat = captures.ball(count)
    place = 4 * torch.rand(count, 3, generator=generator) - 2
    place[:, 2] = height
    scales = torch.tensor([0.1, 0.1, 0.001]).repeat(count, 1)
    return dataclasses.replace(flat, means=place, scales=scales)


def scene() -> Splats:
    return concatenate([captures.ball(2000), table()])


@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
def test_kept_records_are_copied_byte_for_byte(tmp_path, form):
    path = tmp_path / "a.ply"
    write_splats(path, captures.ball(50), ("a comment",))
    if form == "ascii":
        from plyfile import PlyData

        data = PlyData.read(str(path))
        data.text = True
        path = tmp_path / "text.ply"  # plyfile maps the file it read
        data.write(str(path))
    source = read_splats(path)
    mask, reasons = kept_rows(source, [CropBox((0.5, 0, 0), (0.5, 2, 2))])
    write_rows(tmp_path / "b.ply", source, mask)
    result = read_splats(tmp_path / "b.ply")
    assert result.n_rows == mask.sum() < 50
    assert reasons == {"outside_boxes": 50 - int(mask.sum())}
    assert (source.splats.means[torch.from_numpy(mask)] == result.splats.means).all()
    if form != "ascii":
        rows = source.payload.records.reshape(50, -1)[mask]
        assert rows.tobytes() == result.payload.records.tobytes()
    else:
        assert set(result.payload.records.tobytes().splitlines()) <= set(
            source.payload.records.tobytes().splitlines()
        )


def test_boxes_that_keep_nothing_say_where_the_splats_are(tmp_path):
    write_splats(tmp_path / "a.ply", captures.ball(50))
    source = read_splats(tmp_path / "a.ply")
    with pytest.raises(UserError, match=r"keep none of 50 splats; 98 % of the splats lie within"):
        kept_rows(source, [CropBox((9, 9, 9), (1, 1, 1))])


def test_rows_that_cannot_be_drawn_are_dropped_with_a_count(tmp_path):
    ball = captures.ball(50)
    write_splats(tmp_path / "a.ply", ball)
    source = read_splats(tmp_path / "a.ply")
    source.splats.means[3] = float("nan")
    mask, reasons = kept_rows(source, [])
    assert not mask[3]
    assert reasons == {"non_finite_mean": 1}


@pytest.mark.parametrize("known", [True, False])
def test_auto_box_holds_the_object_and_leaves_the_table(known):
    splats = scene()
    up = np.array([0.0, 0.0, 1.0])
    focus = Focus(np.array([0.1, -0.1, 0.1]), 1.3, up) if known else focus_of_splats(splats, up)
    proposal = propose_box(splats, focus)
    assert len(proposal.planes) == 1
    inside = proposal.box.contains(splats.means.numpy())
    ball, flat = inside[:2000], inside[2000:]
    assert ball.mean() > 0.9  # the lowest splats touch the table
    assert flat.mean() < 0.001
    assert max(proposal.box.half_extents) < 0.9


def test_auto_box_turns_with_the_scene():
    from gscomplete.splats import Similarity, transform_splats

    box = CropBox((0, 0, 0), (1, 1, 1), TURN)
    world = Similarity(3.0, torch.from_numpy(box.rotation), torch.tensor([5.0, 6.0, 7.0]))
    splats = transform_splats(scene(), world)
    center = world.apply(torch.zeros(1, 3, dtype=torch.float64))[0].numpy()
    proposal = propose_box(splats, Focus(center, 3.9, box.rotation[:, 2]))
    inside = proposal.box.contains(splats.means.numpy())
    assert inside[:2000].mean() > 0.9
    assert inside[2000:].mean() < 0.001


@pytest.mark.parametrize("width", [0.4, 3.0])
def test_a_wall_goes_and_a_flat_back_stays(width):
    """A figure of half a cylinder whose flat back is all it has, or part of a wall behind it."""
    generator = torch.Generator().manual_seed(5)
    draw = torch.rand(8000, 3, generator=generator)
    front, back = captures.ball(4000), captures.ball(4000)
    angle = math.pi * (draw[:4000, 0] - 0.5)
    places = [0.4 * angle.cos(), 0.4 * angle.sin(), 2 * draw[:4000, 1] - 1]
    front = dataclasses.replace(front, means=torch.stack(places, dim=1))
    flat = (2 * draw[4000:] - 1) * torch.tensor([0.0, width, 1.0])
    back = dataclasses.replace(back, means=flat)
    splats = concatenate([front, back])
    proposal = propose_box(splats, Focus(np.zeros(3), 1.3, np.array([0, 0, 1.0])))
    assert len(proposal.planes) == (width > 1)


def test_auto_box_where_nothing_is():
    with pytest.raises(UserError, match="expected splats where the cameras look"):
        propose_box(captures.ball(50), Focus(np.full(3, 90.0), 1.0, np.array([0, 0, 1.0])))
    faint = dataclasses.replace(captures.ball(50), opacities=torch.full((50,), 0.01))
    with pytest.raises(UserError, match="found 0 solid ones"):
        propose_box(faint, Focus(np.zeros(3), 1.0, np.array([0, 0, 1.0])))


def test_corners_are_the_boxs_own():
    box = CropBox((1, 2, 3), (0.5, 1, 2), TURN)
    corners = box_corners(box)
    shrunk = np.array(box.center) + 0.999 * (corners - np.array(box.center))
    assert box.contains(shrunk).all()
    assert not box.contains(2 * corners - np.array(box.center)).any()
    assert np.linalg.norm(corners[0] - corners[7]) == pytest.approx(2 * np.sqrt(0.25 + 1 + 4))


def test_printed_boxes_read_back():
    for box in (CropBox((1, 2, 3), (0.5, 1, 2)), CropBox((1, 2, 3), (0.5, 1, 2), TURN, "remove")):
        again = parse_box(box_text(box))
        np.testing.assert_allclose(again.center, box.center)
        np.testing.assert_allclose(again.quaternion, box.quaternion, atol=1e-5)
        assert again.action == box.action


def test_nearest_axis():
    assert nearest_axis(np.array([0.1, -2.0, 0.1])) == "-Y"
    assert nearest_axis(np.array([0.0, 0.0, 5.0])) == "Z"


def test_the_up_axis_that_is_given_decides_the_box_and_the_pictures(tmp_path, capsys):
    write_splats(tmp_path / "scene.ply", scene())
    arguments = ["crop", str(tmp_path / "scene.ply"), "--box", "auto", "--propose", "--json"]
    found = []
    for more in (["--up", "Y"], ["--up", "Z"], ["--up=-Y"], []):
        assert main([*arguments, "--out", str(tmp_path / "p"), *more]) == 0
        printed = capsys.readouterr()
        assert ("up axis assumed" in printed.err) == (more == [])
        found.append((json.loads(printed.out)["boxes"], (tmp_path / "p/boxes.png").read_bytes()))
    (tmp_path / "p/boxes.png").write_text("mine")
    assert main([*arguments, "--out", str(tmp_path / "p")]) == 2
    assert "boxes.png: would be replaced" in capsys.readouterr().err
    along = [np.array(up, float) for up in ((0, 1, 0), (0, 0, 1), (0, -1, 0))]
    splats = read_splats(tmp_path / "scene.ply").splats
    for (boxes, _), up in zip(found, along, strict=False):
        expected = propose_box(splats, focus_of_splats(splats, up)).box
        np.testing.assert_allclose(boxes[0]["center"], expected.center)
        np.testing.assert_allclose(boxes[0]["half_extents"], expected.half_extents)
    assert found[2] == found[3]  # -Y is what a splat file has
    assert found[0][1] != found[1][1] != found[2][1]  # each is drawn upright by its own axis


def write_capture(folder: Path) -> dict[str, Any]:
    views = captures.cameras()
    entries = [
        {
            "camera_from_world": views.camera_from_world[index].tolist(),
            "focal_px": views.focal_px[index].tolist(),
            "center_px": views.center_px[index].tolist(),
            "width": views.width,
            "height": views.height,
        }
        for index in range(len(views))
    ]
    content = {"schema": SCHEMA, "status": "finished", "cameras": entries, "extent": 1.0}
    content |= {"up": [0.0, -0.6, 0.8], "look_at": [0.0, 0.0, 0.0]}
    (folder / "capture.json").write_text(json.dumps(content))
    write_splats(folder / "splats.ply", captures.ball(50))
    return content


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("extent", math.inf),
        ("look_at", [0, math.nan, 0]),
        ("camera_from_world", [[math.nan] * 4] * 4),
        ("focal_px", [0.0, 1.0]),
        ("center_px", [math.inf, 1.0]),
        ("width", 10**9),
        ("height", 10**400),
    ],
)
def test_a_damaged_capture_is_named(tmp_path, name, value):
    content = write_capture(tmp_path)
    (content if name in content else content["cameras"][0])[name] = value
    (tmp_path / "capture.json").write_text(json.dumps(content))
    with pytest.raises(UserError, match=r"capture\.json: cannot understand it"):
        read_scene(tmp_path)


def test_a_capture_obeys_an_up_axis_that_is_given(tmp_path):
    write_capture(tmp_path)
    own, given = read_scene(tmp_path), read_scene(tmp_path, "-Y")
    assert (own.up_axis, given.up_axis) == ("Z", "-Y")
    np.testing.assert_array_equal(own.focus().up, [0.0, -0.6, 0.8])
    np.testing.assert_array_equal(given.focus().up, [0.0, -1.0, 0.0])
    assert own.notes == ("up axis Z, 37 degrees from the cameras' mean up direction",)
    assert given.notes == ("up axis -Y, 53 degrees from the cameras' mean up direction",)


def test_the_command_writes_an_object_with_its_boxes(tmp_path, capsys):
    write_splats(tmp_path / "scene.ply", scene())
    out = tmp_path / "ball"
    arguments = ["crop", str(tmp_path / "scene.ply"), "--up", "Z", "--out", str(out)]
    boxes = ["--box", "0,0,0.1,0.7,0.7,0.65", "remove:0.6,0,0,0.1,2,2"]
    assert main([*arguments, *boxes, "--prompt", "a ball", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["subset"] == "multiview"
    assert [box["action"] for box in record["boxes"]] == ["keep", "remove"]
    assert record["steps"][0]["before"] == 3500
    kept = read_splats(out / "partial.ply").splats
    assert record["counts"]["partial"] == len(kept) == record["steps"][0]["after"]
    assert kept.means[:, 0].max() < 0.5
    assert (out / "boxes.png").stat().st_size > 1000
    assert main([*arguments, *boxes]) == 2
    assert "not empty" in capsys.readouterr().err


def test_proposing_prints_and_draws_only(tmp_path, capsys):
    write_splats(tmp_path / "scene.ply", scene())
    arguments = ["crop", str(tmp_path / "scene.ply"), "--up", "Z", "--box", "auto", "--propose"]
    assert main([*arguments, "--out", str(tmp_path / "p")]) == 0
    printed = capsys.readouterr().out
    assert "--box " in printed
    assert sorted(path.name for path in (tmp_path / "p").iterdir()) == ["boxes.png"]


def test_folders_that_are_no_capture_are_named(tmp_path, capsys):
    assert main(["crop", str(tmp_path), "--box", "auto"]) == 2
    assert "capture.json" in capsys.readouterr().err
    (tmp_path / "capture.json").write_text("{}")
    assert main(["crop", str(tmp_path), "--box", "auto"]) == 2
    assert "schema" in capsys.readouterr().err


def test_a_nan_box_is_refused(tmp_path: Path, capsys):
    write_splats(tmp_path / "scene.ply", captures.ball(30))
    assert main(["crop", str(tmp_path / "scene.ply"), "--clean", "2"]) == 2
    assert "--clean: expected 0 to 1, found 2" in capsys.readouterr().err
    assert main(["crop", str(tmp_path / "scene.ply"), "--box", "nan,0,0,1,1,1"]) == 2
    assert "--box" in capsys.readouterr().err


def test_the_first_box_that_keeps_is_the_start_wherever_it_stands():
    points = np.random.default_rng(0).uniform(-1, 1, (500, 3))
    keep, less = CropBox((0, 0, 0), (0.8, 0.8, 0.8)), CropBox((0, 0, 1), (2, 2, 1), action="remove")
    expected = keep.contains(points) & ~less.contains(points)
    assert 0 < expected.sum() < 300
    for boxes in ([keep, less], [less, keep]):
        np.testing.assert_array_equal(inside_boxes(points, boxes), expected)
    np.testing.assert_array_equal(inside_boxes(points, [less]), ~less.contains(points))


def test_proposing_leaves_a_finished_object_alone(tmp_path, capsys):
    write_splats(tmp_path / "scene.ply", scene())
    out = tmp_path / "ball"
    arguments = ["crop", str(tmp_path / "scene.ply"), "--up", "Z", "--out", str(out)]
    assert main([*arguments, "--box", "0,0,0.1,0.7,0.7,0.65"]) == 0
    before = (out / "boxes.png").read_bytes()
    assert main([*arguments, "--box", "0,0,0.1,0.3,0.3,0.3", "--propose"]) == 2
    assert "finished object" in capsys.readouterr().err
    assert (out / "boxes.png").read_bytes() == before
