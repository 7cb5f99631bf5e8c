"""Structure from motion uses again only what was made from the same things."""

from __future__ import annotations

import contextlib
import dataclasses
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscomplete.errors import UserError
from splatcomplete_data.multiview.photos.transforms_json import read_transforms
from splatcomplete_data.multiview.sfm import structure_from_motion as sfm
from tests.builders import captures


class FakeColmap:
    """Writes the model that is asked for, with the first photos of it, and counts."""

    def __init__(self, registered: int) -> None:
        self.registered, self.requests = registered, []

    def __call__(self, request, progress):
        self.requests.append(request)
        names = [name for group in request["groups"] for name in group["names"]]
        model = Path(request["model"])
        captures.colmap_model(model, captures.cameras(), names[: self.registered], text=False)
        return {"registered": self.registered}


@pytest.fixture
def colmap(monkeypatch) -> FakeColmap:
    fake = FakeColmap(8)
    monkeypatch.setattr(sfm, "_run_colmap", fake)
    monkeypatch.setattr(sfm, "has_pycolmap", lambda: True)
    return fake


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    captures.photos(tmp_path / "images", captures.cameras())
    return tmp_path / "images"


def test_a_finished_model_is_read_again(photos, colmap, tmp_path):
    first = sfm.find_poses(photos, tmp_path / "w")
    again = sfm.find_poses(photos, tmp_path / "w", anew=False)
    assert len(colmap.requests) == 1
    assert again.notes == first.notes


def test_too_few_photos_stay_too_few_until_asked_for_otherwise(photos, colmap, tmp_path):
    colmap.registered = 3
    for _ in range(2):
        with pytest.raises(UserError, match=r"3 of 8 photos registered, expected at least 4\. Try"):
            sfm.find_poses(photos, tmp_path / "w")
    assert len(colmap.requests) == 1
    colmap.registered = 8
    found = sfm.find_poses(photos, tmp_path / "w", sfm.SfmSettings(lens_per_photo=True))
    assert len(colmap.requests) == 2
    assert len(found.photos) == 8
    assert "starts again" in found.notes[0]
    assert "made from other settings" in found.notes[0]


def test_other_photos_start_anew_and_leave_what_is_not_ours(photos, colmap, tmp_path):
    work = tmp_path / "w"
    sfm.find_poses(photos, work)
    (work / "database.db").write_text("features of the old photos")
    (work / "letter.txt").write_text("mine")
    Image.new("RGB", (32, 32)).save(photos / "photo_03.png")
    with pytest.raises(UserError, match="w: cannot resume, as it was made from other photos"):
        sfm.find_poses(photos, work, anew=False)
    assert (work / "database.db").exists()
    assert "made from other photos" in sfm.find_poses(photos, work).notes[0]
    assert len(colmap.requests) == 2
    assert not (work / "database.db").exists()
    assert (work / "letter.txt").read_text() == "mine"


@pytest.mark.parametrize("text", [None, "{", "[]"])
def test_what_does_not_say_what_it_was_made_from_is_not_used(photos, colmap, tmp_path, text):
    sfm.find_poses(photos, tmp_path / "w")
    (tmp_path / "w/made_from.json").unlink()
    if text is not None:
        (tmp_path / "w/made_from.json").write_text(text)
    sfm.find_poses(photos, tmp_path / "w")
    assert len(colmap.requests) == 2
    sfm.find_poses(photos, tmp_path / "w")
    assert len(colmap.requests) == 2


def test_nothing_is_cleared_where_nothing_can_be_computed(photos, colmap, tmp_path, monkeypatch):
    sfm.find_poses(photos, tmp_path / "w")
    monkeypatch.setattr(sfm, "has_pycolmap", lambda: False)
    assert len(sfm.find_poses(photos, tmp_path / "w").photos) == 8
    with pytest.raises(UserError, match="needs pycolmap"):
        sfm.find_poses(photos, tmp_path / "w", sfm.SfmSettings(seed=1))
    assert (tmp_path / "w/sparse/0/images.bin").is_file()


def test_points_belong_to_their_poses_and_lenses(colmap, tmp_path):
    posed = read_transforms(captures.transforms_capture(tmp_path) / "transforms.json")
    photo = posed.photos[0]
    moved = photo.camera_from_world.copy()
    moved[0, 3] += 0.1
    longer = dataclasses.replace(photo.lens, focal_px=(50.0, 50.0))
    for change in ({}, {"camera_from_world": moved}, {"lens": longer}):
        first = dataclasses.replace(photo, **change)
        other = dataclasses.replace(posed, photos=(first, *posed.photos[1:]))
        _, notes = sfm.triangulate(other, tmp_path / "w")
        assert bool(notes) == bool(change)
        _, notes = sfm.triangulate(other, tmp_path / "w", anew=False)
        assert notes == ()
    assert len(colmap.requests) == 3


def test_photos_of_one_name_in_two_folders_are_two(colmap, tmp_path):
    sfm.triangulate(read_transforms(captures.nested_capture(tmp_path)), tmp_path / "w")
    (request,) = colmap.requests
    expected = {f"{side}/{i:04}.png" for side in ("left", "right") for i in range(4)}
    assert set(request["poses"]) == expected
    assert {name for group in request["groups"] for name in group["names"]} == expected
    assert request["images"] == str(tmp_path / "images")


@pytest.mark.skipif(not sfm.has_pycolmap(), reason="pycolmap is not installed")
def test_colmap_knows_photos_in_folders_by_these_names(tmp_path):
    posed = read_transforms(captures.nested_capture(tmp_path))
    for index, photo in enumerate(posed.photos):
        noise = np.random.default_rng(index).integers(0, 256, (32, 32, 3), dtype=np.uint8)
        Image.fromarray(noise).save(photo.path)
    sfm.triangulate(posed, tmp_path / "w")
    with contextlib.closing(sqlite3.connect(tmp_path / "w/database.db")) as database:
        stored = {name for (name,) in database.execute("SELECT name FROM images")}
    assert stored == set(posed.names)


def test_known_poses_say_which_photos_are_compared(colmap, tmp_path):
    posed = read_transforms(captures.transforms_capture(tmp_path) / "transforms.json")
    sfm.triangulate(posed, tmp_path / "w")
    sfm.triangulate(posed, tmp_path / "all", sfm.SfmSettings(matching="exhaustive"))
    spaced = tmp_path / "with spaces"
    spaced.mkdir()
    photos = tuple(
        dataclasses.replace(photo, path=photo.path.rename(spaced / f"photo {index}.png"))
        for index, photo in enumerate(posed.photos)
    )
    sfm.triangulate(dataclasses.replace(posed, photos=photos), tmp_path / "s")
    near, everything, unlisted = colmap.requests
    assert near["matching"] == "listed"
    assert {name for pair in near["pairs"] for name in pair} == set(posed.names)
    assert everything["matching"] == "exhaustive"
    assert unlisted["matching"] == "exhaustive"
