"""What is read of an object folder is what the data side wrote."""

import json

import pytest

from gscomplete.errors import UserError
from gscomplete.folders import object_folder_of, read_object_folder
from gscomplete.splats import write_splats
from gscomplete.views import ObjectFrame, ViewDistribution
from splatcomplete_data.objects import read_record
from tests.builders.folders import write_object_folder
from tests.builders.objects import random_splats


@pytest.fixture
def folder(tmp_path):
    return write_object_folder(tmp_path / "mug", random_splats(5), random_splats(9))


def test_fields_are_those_of_the_record(folder):
    found = read_object_folder(folder)
    assert (found.id, found.subset, found.prompt) == ("mug", "mesh", "a red mug")
    assert found.frame == ObjectFrame("Y", (0.1, 0.0, 0.0), 1.25)
    assert (found.known_center, found.known_size) == ((0.1, 0.0, 0.0), 1.25)
    assert found.views == ViewDistribution(30.0, 10.0, 40.0, 12.0)
    assert found.partial == folder / "partial.ply"
    assert found.complete == folder / "complete.ply"
    assert {"partial.ply", "complete.ply", "preview.png"} == found.files


@pytest.mark.parametrize("origin", ["truth", "guess"])
def test_a_frame_of_the_truth_or_of_a_guess_is_not_known(tmp_path, origin):
    folder = write_object_folder(tmp_path / "cup", random_splats(5), frame_origin=origin)
    found = read_object_folder(folder)
    assert (found.known_center, found.known_size) == (None, None)
    assert found.complete is None


def test_a_center_alone_is_known(tmp_path):
    changes = {"frame_origin": "guess", "frame_given": ("center",)}
    found = read_object_folder(write_object_folder(tmp_path / "cup", random_splats(5), **changes))
    assert (found.known_center, found.known_size) == ((0.1, 0.0, 0.0), None)


@pytest.mark.parametrize("name", ["", "object.json", "partial.ply", "complete.ply", "preview.png"])
def test_the_folder_and_its_files_mean_the_object(folder, name):
    found = object_folder_of(folder / name)
    assert found is not None
    assert found.folder == folder


def test_what_the_record_does_not_name_means_itself(folder, tmp_path):
    (folder / "mine.ply").write_bytes(b"ply")
    assert object_folder_of(folder / "mine.ply") is None
    assert object_folder_of(folder / "absent.ply") is None
    assert object_folder_of(tmp_path) is None


def test_an_object_file_of_another_program_is_none_of_ours(tmp_path):
    (tmp_path / "object.json").write_text('{"frame": []}')
    (tmp_path / "a.ply").write_bytes(b"ply")
    assert object_folder_of(tmp_path / "a.ply") is None
    with pytest.raises(UserError, match=r"schema: expected 'splatcomplete\.object', found None"):
        object_folder_of(tmp_path)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("version", 2, "version: expected 1, found 2"),
        ("id", "../../evil", r"id: expected a plain name, found '\.\./\.\./evil'"),
        ("prompt", " ", "prompt: expected a text, found ' '"),
        ("prompt", "\udcff", "prompt: expected a text, found"),
        ("frame_origin", "luck", "frame_origin: expected one of truth, guess, given, found 'luck'"),
        ("frame_given", ["up"], r"frame_given: expected some of center, size, found \['up'\]"),
        ("frame_given", "size", "frame_given: expected some of center, size, found 'size'"),
        ("frame", None, "frame: the top level: expected an object"),
        ("views", None, "views: view distribution: expected an object"),
        ("files", None, "files: expected an object, found None"),
        ("subset", "video", "subset: expected one of multiview, singleview, .* found 'video'"),
        ("subset", ["mesh"], r"subset: expected one of .* found \['mesh'\]"),
        ("prompt", "a \x1b[31mmug", r"prompt: .* without control characters, found 'a \\x1b\[31m"),
    ],
)
def test_what_is_wrong_is_named(folder, name, value, message):
    path = folder / "object.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {name: value}))
    with pytest.raises(UserError, match=message):
        object_folder_of(folder / "partial.ply")


@pytest.mark.parametrize(("place", "is_seen"), [(1.6, True), (1.7, False), (1e300, False)])
def test_views_past_the_object_are_refused(folder, place, is_seen):
    path = folder / "object.json"
    data = json.loads(path.read_text())
    data["views"]["target"] = [0.0, 0.0, place]
    path.write_text(json.dumps(data))
    for read in (read_object_folder, read_record):
        if is_seen:
            assert read(folder).views.target == (0.0, 0.0, place)
        else:
            with pytest.raises(UserError, match=r"object\.json: views: target: expected a point"):
                read(folder)


def test_a_replaced_file_is_told_from_the_recorded_one(folder):
    found = read_object_folder(folder)
    assert not found.is_replaced(found.partial)
    write_splats(found.partial, random_splats(6))
    assert found.is_replaced(found.partial)
    found.partial.unlink()
    assert not found.is_replaced(found.partial)
