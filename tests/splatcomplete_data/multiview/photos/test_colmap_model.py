from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gscomplete.errors import UserError
from splatcomplete_data.multiview.photos.colmap_model import (
    find_model,
    lens_from_colmap,
    read_colmap,
    read_points,
)
from tests.splatcomplete_data.multiview import captures


def write(folder: Path, *, text: bool, camera: tuple | None = None) -> tuple[Path, Path]:
    views = captures.cameras()
    names = captures.photos(folder / "images", views)
    captures.colmap_model(folder / "sparse/0", views, names, text=text, camera=camera)
    return folder / "sparse/0", folder / "images"


@pytest.mark.parametrize("text", [True, False])
def test_poses_lens_and_points_come_back(tmp_path, text):
    posed = read_colmap(*write(tmp_path, text=text))
    found = np.stack([photo.camera_from_world for photo in posed.photos])
    np.testing.assert_allclose(found, captures.cameras().camera_from_world.numpy(), atol=1e-6)
    assert posed.points is not None
    np.testing.assert_allclose(posed.points.points[:, 0], [0, 0.1, 0.2])
    np.testing.assert_allclose(posed.points.colors[2] * 255, [20, 20, 255], atol=1e-4)


@pytest.mark.parametrize(
    ("name", "numbers", "focal", "center", "radial", "tangential"),
    [
        ("SIMPLE_PINHOLE", (9, 1, 2), (9, 9), (1, 2), (0,) * 6, (0, 0)),
        ("PINHOLE", (9, 8, 1, 2), (9, 8), (1, 2), (0,) * 6, (0, 0)),
        ("SIMPLE_RADIAL", (9, 1, 2, 0.1), (9, 9), (1, 2), (0.1, 0, 0, 0, 0, 0), (0, 0)),
        ("RADIAL", (9, 1, 2, 0.1, 0.2), (9, 9), (1, 2), (0.1, 0.2, 0, 0, 0, 0), (0, 0)),
        (
            "OPENCV",
            (9, 8, 1, 2, 0.1, 0.2, 0.3, 0.4),
            (9, 8),
            (1, 2),
            (0.1, 0.2, 0, 0, 0, 0),
            (0.3, 0.4),
        ),
        (
            "FULL_OPENCV",
            (9, 8, 1, 2, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8),
            (9, 8),
            (1, 2),
            (0.1, 0.2, 0.5, 0.6, 0.7, 0.8),
            (0.3, 0.4),
        ),
        (
            "OPENCV_FISHEYE",
            (9, 8, 1, 2, 0.1, 0.2, 0.3, 0.4),
            (9, 8),
            (1, 2),
            (0.1, 0.2, 0.3, 0.4, 0, 0),
            (0, 0),
        ),
    ],
)
def test_every_camera_model(name, numbers, focal, center, radial, tangential):
    lens = lens_from_colmap(name, 10, 10, numbers)
    assert (lens.focal_px, lens.center_px) == (focal, center)
    assert (lens.radial, lens.tangential) == (radial, tangential)
    assert lens.kind == ("fisheye" if "FISHEYE" in name else "brown")


def test_scaled_photos_get_a_scaled_lens_and_other_shapes_are_refused(tmp_path):
    big = ("PINHOLE", 1, 320, 320, [500.0, 500.0, 160.0, 160.0])
    posed = read_colmap(*write(tmp_path / "big", text=False, camera=big))
    assert posed.photos[0].lens.focal_px == (50.0, 50.0)
    wide = ("PINHOLE", 1, 640, 320, [500.0, 500.0, 320.0, 160.0])
    with pytest.raises(UserError, match="expected the shape of its camera, 640 x 320"):
        read_colmap(*write(tmp_path / "wide", text=False, camera=wide))


def test_missing_photos_are_counted(tmp_path):
    model, images = write(tmp_path, text=False)
    (images / "photo_00.png").unlink()
    posed = read_colmap(model, images)
    assert len(posed.photos) == 7
    assert "1 of 8 images of the model left out" in posed.notes[0]


def test_unknown_camera_models_and_cameras_are_named(tmp_path):
    with pytest.raises(UserError, match="number 77 is not understood"):
        read_colmap(*write(tmp_path / "a", text=False, camera=("X", 77, 32, 32, [])))
    model, images = write(tmp_path / "b", text=True)
    (model / "cameras.txt").write_text("5 PINHOLE 32 32 40 40 16 16\n")
    with pytest.raises(UserError, match="camera 1 is not in"):
        read_colmap(model, images)
    (model / "cameras.txt").write_text("1 PINHOLE wide\n")
    with pytest.raises(UserError, match="line 1: expected CAMERA_ID"):
        read_colmap(model, images)


def test_a_pose_without_rotation_is_refused(tmp_path):
    model, images = write(tmp_path, text=True)
    line = "1 0 0 0 0 0 0 0 1 photo_00.png\n\n"
    (model / "images.txt").write_text(line)
    with pytest.raises(UserError, match="expected a finite pose"):
        read_colmap(model, images)


def test_a_model_is_found_in_the_usual_places(tmp_path):
    model, _ = write(tmp_path, text=False)
    assert find_model(tmp_path) == model
    assert find_model(model) == model
    assert find_model(tmp_path / "images") is None


def test_empty_points_are_none(tmp_path):
    (tmp_path / "points3D.bin").write_bytes(struct.pack("<Q", 0))
    assert read_points(tmp_path) is None


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    name=st.sampled_from(["cameras", "images", "points3D"]),
    text=st.booleans(),
    cut=st.floats(0, 1),
    place=st.floats(0, 1),
    junk=st.binary(max_size=9),
)
def test_mutated_files_end_in_a_message_or_a_result(tmp_path_factory, name, text, cut, place, junk):
    folder = tmp_path_factory.getbasetemp() / f"fuzz_{text}"
    if not folder.exists():
        write(folder, text=text)
    model = folder / "sparse/0"
    path = model / f"{name}{'.txt' if text else '.bin'}"
    good = path.read_bytes()
    at = int(place * len(good))
    bad = (good[:at] + junk + good[at + len(junk) :])[: int(cut * len(good)) + 1]
    path.write_bytes(bad)
    message = str(folder)
    try:
        read_colmap(model, folder / "images")
    except UserError as error:
        message = str(error)
    finally:
        path.write_bytes(good)
    assert str(folder) in message


@pytest.mark.parametrize("color", ["1e39", "-1", "256", "inf"])
def test_a_colour_out_of_range_is_named(tmp_path, color):
    (tmp_path / "points3D.txt").write_text(f"1 0 0 0 9 9 9 0\n2 0 0 0 9 {color} 9 0\n")
    with pytest.raises(UserError, match="line 2: expected a colour of 0 to 255"):
        read_points(tmp_path)
