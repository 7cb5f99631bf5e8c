from __future__ import annotations

import dataclasses
import sqlite3
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import ExifTags, Image

from gscomplete.errors import UserError
from gscomplete.splats import Similarity
from splatcomplete_data.multiview.photos.capture import (
    find_masks,
    levelled,
    open_capture,
    transformed,
    up_direction,
)
from splatcomplete_data.multiview.photos.posed import PosedPhotos
from splatcomplete_data.multiview.photos.transforms_json import read_transforms
from splatcomplete_data.multiview.sfm import folder as sfm_folder
from splatcomplete_data.multiview.sfm import structure_from_motion as sfm
from splatcomplete_data.scan import PointCloud
from tests.builders import captures


def with_points(posed: PosedPhotos) -> PosedPhotos:
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))
    return dataclasses.replace(posed, points=PointCloud(points, np.ones((20, 3), np.float32)))


@pytest.fixture
def posed(tmp_path: Path) -> PosedPhotos:
    folder = captures.transforms_capture(tmp_path)
    return with_points(read_transforms(folder / "transforms.json"))


def tilted() -> Similarity:
    axis, angle = np.array([1.0, 2.0, 3.0]) / np.sqrt(14), 2.2
    k = np.cross(np.eye(3), -axis)
    rotation = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    return Similarity(7.0, torch.from_numpy(rotation), torch.tensor([5.0, -3.0, 11.0]))


def pixels(posed: PosedPhotos) -> np.ndarray:  # [V, N, 2]
    out = []
    assert posed.points is not None
    for photo in posed.photos:
        pose = photo.camera_from_world
        local = posed.points.points @ pose[:3, :3].T + pose[:3, 3]
        out.append(local[:, :2] / local[:, 2:])
    return np.stack(out)


def test_another_world_frame_shows_the_same_pictures(posed):
    moved = transformed(posed, tilted())
    # The cameras' rotations come from float32, so they are rotations to 1e-7 only.
    np.testing.assert_allclose(pixels(moved), pixels(posed), atol=1e-6)
    expected = tilted().apply(torch.from_numpy(posed.positions)).numpy()
    np.testing.assert_allclose(moved.positions, expected, atol=1e-5)


def test_levelling_undoes_any_frame(posed):
    moved = transformed(posed, tilted())
    result = levelled(moved)
    assert result.world_from_source is not None
    np.testing.assert_allclose(pixels(result.posed), pixels(posed), atol=1e-5)
    np.testing.assert_allclose(up_direction(result.posed), [0, 0, 1], atol=1e-5)
    np.testing.assert_allclose(result.posed.look_at(), 0, atol=1e-5)
    distance = np.linalg.norm(result.posed.positions, axis=1)
    assert distance.mean() == pytest.approx(1.0)
    # Ring cameras at 20 degrees of elevation stand above the object again.
    np.testing.assert_allclose(result.posed.positions[:, 2], np.sin(np.deg2rad(20)), atol=1e-5)


def test_up_of_a_short_arc_is_the_photos_own(posed):
    arc = dataclasses.replace(posed, photos=posed.photos[:1] * 3)
    expected = -posed.photos[0].camera_from_world[1, :3]
    np.testing.assert_allclose(up_direction(arc), expected, atol=1e-9)


def test_photos_stored_on_their_side_are_levelled_too(posed, tmp_path):
    # Tag 6: what is shown as right is the stored -y, what is shown as up is the stored -x.
    stored_from_shown = np.diag([0.0, 0.0, 1.0, 1.0])
    stored_from_shown[0, 1], stored_from_shown[1, 0] = 1.0, -1.0
    photos = []
    for index, photo in enumerate(posed.photos):
        path = tmp_path / f"{index}.jpg"
        image = Image.new("RGB", (8, 8))
        exif = image.getexif()
        exif[ExifTags.Base.Orientation] = 6
        image.save(path, exif=exif)
        pose = stored_from_shown @ photo.camera_from_world
        photos.append(dataclasses.replace(photo, path=path, camera_from_world=pose))
    turned = dataclasses.replace(posed, photos=tuple(photos))
    np.testing.assert_allclose(up_direction(turned), up_direction(posed), atol=1e-6)


def test_poses_are_found_where_they_stand(tmp_path):
    folder = captures.transforms_capture(tmp_path / "a")
    assert open_capture(folder, "auto", tmp_path / "w").posed.source.endswith("transforms.json")
    views = captures.cameras()
    names = captures.photos(tmp_path / "b" / "images", views)
    captures.colmap_model(tmp_path / "b" / "sparse/0", views, names, text=False)
    found = open_capture(tmp_path / "b", "auto", tmp_path / "w")
    assert found.posed.source.endswith("sparse/0")
    assert found.world_from_source is None
    given = open_capture(tmp_path / "b", str(tmp_path / "b/sparse/0"), tmp_path / "w")
    assert len(given.posed.photos) == 8
    given = open_capture(tmp_path / "b", str(folder / "transforms.json"), tmp_path / "w")
    assert given.posed.photos[0].path.parent == tmp_path / "b/images"


def test_photos_in_folders_are_found_by_the_names_that_poses_give_them(tmp_path):
    folder = captures.nested_capture(tmp_path / "a").parent
    names = [f"{side}/{index:04}.png" for side in ("left", "right") for index in range(4)]
    captures.colmap_model(folder / "sparse/0", captures.cameras(), names, text=True)
    given = open_capture(folder, "auto", tmp_path / "w").posed
    assert given.source.endswith("transforms.json")
    assert given.names == tuple(names)
    (folder / "transforms.json").rename(tmp_path / "transforms.json")
    Image.new("RGB", (9, 9)).save(folder / "preview.png")  # not one of the model's photos
    model = open_capture(folder, "auto", tmp_path / "w").posed
    assert model.source.endswith("sparse/0")
    assert model.names == tuple(names)
    assert model.folder == folder / "images"
    (folder / "preview.png").unlink()
    apart = open_capture(folder, str(tmp_path / "transforms.json"), tmp_path / "w").posed
    assert apart.names == tuple(names)
    paths = [photo.camera_from_world for photo in apart.photos]
    np.testing.assert_array_equal(paths, [photo.camera_from_world for photo in given.photos])


def test_names_are_plain_where_all_photos_are_in_one_folder(tmp_path):
    folder = captures.nested_capture(tmp_path).parent
    names = [f"left/{index:04}.png" for index in range(4)]
    captures.colmap_model(folder / "sparse/0", captures.cameras(), names, text=False)
    (folder / "transforms.json").unlink()
    assert open_capture(folder, "auto", tmp_path / "w").posed.names[0] == "0000.png"


def test_what_is_not_there_is_named(tmp_path):
    with pytest.raises(UserError, match="expected a folder of photos"):
        open_capture(tmp_path / "none", "auto", tmp_path / "w")
    with pytest.raises(UserError, match="expected photos"):
        open_capture(tmp_path, "auto", tmp_path / "w")
    with pytest.raises(UserError, match="--poses: expected auto, sfm"):
        open_capture(tmp_path, str(tmp_path / "nothing.json"), tmp_path / "w")


def test_masks_are_found_beside_the_photos(tmp_path):
    (tmp_path / "capture/images").mkdir(parents=True)
    assert find_masks(tmp_path / "capture") is None
    (tmp_path / "capture/masks").mkdir()
    assert find_masks(tmp_path / "capture") == tmp_path / "capture/masks"
    assert find_masks(tmp_path / "capture/images") == tmp_path / "capture/masks"


def test_missing_pycolmap_is_one_line(tmp_path, monkeypatch):
    captures.photos(tmp_path / "images", captures.cameras(3))
    monkeypatch.setattr(sfm, "has_pycolmap", lambda: False)
    with pytest.raises(UserError, match=r"needs pycolmap.*gscomplete\[data\].*--poses"):
        sfm.find_poses(tmp_path / "images", tmp_path / "work")


@pytest.mark.skipif(not sfm.has_pycolmap(), reason="pycolmap is not installed")
def test_photos_that_do_not_register_say_how_many_and_what_to_try(tmp_path, monkeypatch):
    # COLMAP does not wait for a locked database: a reader beside it makes it fail.
    monkeypatch.delattr(sqlite3, "connect")
    for index in range(3):
        noise = np.random.default_rng(index).integers(0, 256, (64, 64, 3), dtype=np.uint8)
        (tmp_path / "images").mkdir(exist_ok=True)
        Image.fromarray(noise).save(tmp_path / f"images/{index}.png")
    stages = []
    with pytest.raises(UserError, match=r"0 of 3 photos registered, expected at least 3\. Try"):
        sfm.find_poses(
            tmp_path / "images", tmp_path / "work", progress=lambda *told: stages.append(told[0])
        )
    assert set(stages) == {"features", "pairs", "cameras"}


@pytest.mark.skipif(not sfm.has_pycolmap(), reason="pycolmap is not installed")
def test_a_native_failure_is_a_message(tmp_path):
    (tmp_path / "images").mkdir()
    for index in range(3):
        Image.new("RGB", (32, 32)).save(tmp_path / f"images/{index}.png")
    photos = {path.name: path for path in (tmp_path / "images").iterdir()}
    sfm_folder.begin(tmp_path / "work", sfm_folder.made_from(photos, sfm.SfmSettings()))
    (tmp_path / "work/database.db").write_bytes(b"this is no database, " * 400)
    with pytest.raises(UserError, match="COLMAP failed"):
        sfm.find_poses(tmp_path / "images", tmp_path / "work")


def test_levelling_gives_one_frame_whatever_the_sources(posed):
    one, other = levelled(posed).posed, levelled(transformed(posed, tilted())).posed
    np.testing.assert_allclose(one.positions, other.positions, atol=1e-5)
    x, y, _ = one.positions[0]
    assert x > 0
    assert y == pytest.approx(0.0, abs=1e-9)
