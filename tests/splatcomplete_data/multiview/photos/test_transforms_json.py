from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gscomplete.errors import UserError
from splatcomplete_data.multiview.photos.transforms_json import read_transforms
from tests.splatcomplete_data.multiview import captures

FOX = Path(__file__).parents[5] / "shared/data/multiview/fox/transforms.json"


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    return captures.transforms_capture(tmp_path) / "transforms.json"


def changed(path: Path, **values: object) -> Path:
    data = json.loads(path.read_text())
    data.update(values)
    path.write_text(json.dumps({k: v for k, v in data.items() if v is not None}))
    return path


def test_poses_and_lens_come_back(capture):
    posed = read_transforms(capture)
    views = captures.cameras()
    found = np.stack([photo.camera_from_world for photo in posed.photos])
    np.testing.assert_allclose(found, views.camera_from_world.numpy(), atol=1e-6)
    assert posed.photos[0].lens.focal_px[0] == pytest.approx(float(views.focal_px[0, 0]))
    np.testing.assert_allclose(posed.look_at(), 0, atol=1e-5)


def test_focal_length_from_an_angle(capture):
    angle = np.deg2rad(captures.FOV_DEG)
    posed = read_transforms(changed(capture, fl_x=None, fl_y=None, camera_angle_x=angle))
    expected = 0.5 * captures.SIZE_PX / np.tan(angle / 2)
    assert posed.photos[0].lens.focal_px == pytest.approx((expected, expected))


def test_a_frames_own_intrinsics_win(capture):
    data = json.loads(capture.read_text())
    data["frames"][2]["fl_x"] = 99.0
    capture.write_text(json.dumps(data))
    focal = [photo.lens.focal_px[0] for photo in read_transforms(capture).photos]
    assert focal[2] == 99.0
    assert focal[1] != 99.0


def test_missing_photos_are_counted_not_silent(capture):
    (capture.parent / "images/photo_03.png").unlink()
    posed = read_transforms(capture)
    assert len(posed.photos) == 7
    assert "1 of 8 frames left out" in posed.notes[0]
    assert "photo_03.png" in posed.notes[0]


def test_too_few_photos_say_why(capture):
    for path in sorted((capture.parent / "images").iterdir())[:-2]:
        path.unlink()
    with pytest.raises(UserError, match=r"at least 3 photos.*found 2; 6 of 8 frames left out"):
        read_transforms(capture)


def test_names_without_suffix_are_found(capture):
    data = json.loads(capture.read_text())
    for frame in data["frames"]:
        frame["file_path"] = frame["file_path"].removesuffix(".png")
    capture.write_text(json.dumps(data))
    assert len(read_transforms(capture).photos) == 8


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"frames": None}, "array 'frames'"),
        ({"frames": [3]}, r"frames\[0\].*file_path"),
        ({"fl_x": None, "fl_y": None}, "fl_x"),
        ({"fl_x": "wide"}, "fl_x: expected a finite number"),
        ({"fl_x": -5}, "focal length"),
        ({"fl_x": 10**400}, "fl_x: expected a finite number"),
        ({"w": 64}, "expected the size of photo_00.png"),
        ({"camera_model": "THIN_PRISM"}, "camera_model"),
        ({"k4": 0.1}, "k4: expected 0"),
        ({"camera_angle_x": 4.0, "fl_x": None}, "camera_angle_x: expected 0 to pi"),
    ],
)
def test_wrong_fields_are_named(capture, values, words):
    with pytest.raises(UserError, match=words):
        read_transforms(changed(capture, **values))


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        (None, "4 x 4"),
        ([[1, 2], [3, 4]], "4 x 4"),
        ("text", "4 x 4"),
        (np.zeros((4, 4)).tolist(), "singular"),
        (np.diag([2.0, 1, 1, 1]).tolist(), "stretches"),
        (np.diag([-1.0, 1, 1, 1]).tolist(), "mirrors"),
        ([[float("nan")] * 4] * 4, "4 x 4"),
        ([[10**400] * 4] * 4, "4 x 4"),
        (np.diag([1.0, 1, 1, 0]).tolist(), "last row of 0 0 0 1, found 0 0 0 0"),
    ],
)
def test_wrong_poses_are_named(capture, matrix, words):
    data = json.loads(capture.read_text())
    data["frames"][0]["transform_matrix"] = matrix
    capture.write_text(json.dumps(data))
    with pytest.raises(UserError, match=words):
        read_transforms(capture)


def test_a_mask_that_does_not_exist_is_an_error(capture):
    data = json.loads(capture.read_text())
    data["frames"][1]["mask_path"] = "masks/none.png"
    capture.write_text(json.dumps(data))
    with pytest.raises(UserError, match=r"frames\[1\]: mask_path"):
        read_transforms(capture)


def test_something_else_is_refused(tmp_path):
    for text in ("", "[]", "{", '{"frames": {}}'):
        path = tmp_path / "transforms.json"
        path.write_text(text)
        with pytest.raises(UserError, match=r"transforms\.json"):
            read_transforms(path)


@pytest.mark.skipif(not FOX.is_file(), reason="shared/data is not here")
def test_real_fox():
    posed = read_transforms(FOX)
    assert len(posed.photos) == 50
    assert "17 of 67 frames left out" in posed.notes[0]
    assert not posed.photos[0].lens.is_pinhole
