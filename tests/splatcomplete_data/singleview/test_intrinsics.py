"""Intrinsics of every form give the same numbers; those of another picture are refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscomplete.errors import UserError
from splatcomplete_data import cli
from splatcomplete_data.singleview.intrinsics import (
    Intrinsics,
    from_matrix,
    from_numbers,
    read_intrinsics,
)
from splatcomplete_data.singleview.unproject import unproject

ROWS = [525.0, 0, 319.5, 0, 526.0, 239.5, 0, 0, 1]
COLUMNS = [525.0, 0, 0, 0, 526.0, 0, 319.5, 239.5, 1]
NUMBERS = {"fx": 525, "fy": 526, "width": 640, "height": 480}


def numbers(found: Intrinsics | None) -> tuple[float, ...]:
    assert found is not None
    return found.focal_x_px, found.focal_y_px, found.center_x_px, found.center_y_px


@pytest.mark.parametrize(
    "content",
    [
        "525 526 319.5 239.5",
        " ".join(map(str, ROWS)),
        " ".join(map(str, COLUMNS)),
        "525 0 319.5\n0 526 239.5\n0 0 1\n",
        "525,0,0\n0,526,0\n319.5,239.5,1\n",
        {"K": COLUMNS, "w": 640, "h": 480, "dw": 192, "dh": 256, "fps": 60},  # Record3D
        {"K": ROWS, "width": 640, "height": 480},
        {**NUMBERS, "cx": 319.5, "cy": 239.5},
        {"fl_x": 525, "fl_y": 526, "cx": 319.5, "cy": 239.5, "w": 640, "h": 480},  # nerfstudio
    ],
)
def test_every_form_gives_the_same_numbers(tmp_path, content):
    path = tmp_path / "k.txt"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    assert numbers(read_intrinsics(path, 640, 480)) == (525, 526, 319.5, 239.5)


@pytest.mark.parametrize(
    "content",
    [
        {"intrinsic_matrix": COLUMNS},  # Open3D
        {"intrinsic_matrix": np.reshape(ROWS, (3, 3)).tolist()},
        {"K": ROWS, "width": 640, "height": 480, "D": [0, 0, 0, 0, 0]},  # ROS 1
        {"k": ROWS, "width": 640, "height": 480, "d": [0, 0, 0, 0, 0]},  # ROS 2
        {**NUMBERS, "ppx": 319.5, "ppy": 239.5, "model": 2, "coeffs": [0, 0, 0, 0, 0]},  # RealSense
    ],
)
def test_pixel_centres_at_whole_numbers_are_moved_by_half_a_pixel(tmp_path, content):
    (tmp_path / "k.json").write_text(json.dumps(content))
    found = read_intrinsics(tmp_path / "k.json", 640, 480)
    assert numbers(found) == (525, 526, 320, 240)
    points = unproject(np.full((480, 640), 2.0), found, np.full((480, 640), True))
    np.testing.assert_allclose(points[:, :2].mean(axis=0), 0, atol=1e-9)


def test_a_file_without_a_principal_point_says_so(tmp_path):
    (tmp_path / "k.json").write_text(json.dumps(NUMBERS))
    found = read_intrinsics(tmp_path / "k.json", 640, 480)
    assert numbers(found) == (525, 526, 320, 240)
    assert "k.json, which has no principal point (the middle)" in found.summary()


def test_what_is_no_camera_matrix_is_shown(tmp_path):
    with pytest.raises(UserError, match="expected fx 0 cx; 0 fy cy; 0 0 1, found 1 2 3; 4 5 6; 7"):
        from_matrix(np.arange(1.0, 10.0).reshape(3, 3), 640, 480, "here")


@pytest.mark.parametrize("center", [(0, 0), (-1, 240), (320, 480), (960, 540)])
def test_a_principal_point_outside_the_picture_is_refused(tmp_path, center):
    (tmp_path / "k.txt").write_text(f"525 525 {center[0]} {center[1]}")
    with pytest.raises(UserError, match=r"\(k.txt\): .* picture of 640 x 480 .*resolution"):
        read_intrinsics(tmp_path / "k.txt", 640, 480)


def test_options_of_one_two_or_four_numbers():
    assert numbers(from_numbers([525], None, None, 640, 480)) == (525, 525, 320, 240)
    assert numbers(from_numbers([525, 526], [319, 239], None, 640, 480)) == (525, 526, 319, 239)
    assert numbers(from_numbers([525, 526, 319, 239], None, None, 640, 480)) == (525, 526, 319, 239)
    with pytest.raises(UserError, match="expected one principal point, found two"):
        from_numbers([525, 526, 319, 239], [319, 239], None, 640, 480)
    for count in (3, 5, 7):
        with pytest.raises(UserError, match=f"--focal: expected F, .* found {count} numbers"):
            from_numbers([100.0] * count, None, None, 640, 480)


def depth_command(folder: Path, *words: str) -> int:
    Image.new("RGB", (32, 24), (90, 120, 150)).save(folder / "photo.png")
    np.save(folder / "depth.npy", np.full((24, 32), 2.0))
    start = ["depth", str(folder / "photo.png"), str(folder / "depth.npy"), "--no-outliers"]
    return cli.main([*start, *words, "--out", str(folder / "out")])


def test_the_command_takes_the_principal_point_with_the_focal_length(tmp_path, capsys):
    assert depth_command(tmp_path, "--focal", "40,41,10,20") == 0
    record = json.loads((tmp_path / "out/object.json").read_text())
    assert record["details"]["camera"]["center_x_px"] == 10
    told = "intrinsics from options: fx 40, fy 41, cx 10, cy 20 px of 32 x 24"
    assert told in record["notes"]
    assert told in capsys.readouterr().out


@pytest.mark.parametrize("words", ["1,2,3", "1,2,3,4,5,6,7", "a", "40,", "40,inf"])
def test_the_command_refuses_other_numbers(tmp_path, capsys, words):
    assert depth_command(tmp_path, "--focal", words) == 2
    assert "--focal: expected F, FX,FY or FX,FY,CX,CY" in capsys.readouterr().err
