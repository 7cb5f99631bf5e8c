"""Object folders: whole or not at all, read back as written, refused when odd."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from gscomplete.errors import UserError
from gscomplete.util.digests import sha256_of
from splatcomplete_data.atomic_folder import atomic_folder, forget_leftovers
from splatcomplete_data.cli.common import ObjectOptions, check_out
from splatcomplete_data.cuts.boxes import CropBox, inside_boxes, parse_box
from splatcomplete_data.objects import (
    read_object,
    read_record,
    write_object,
)
from tests.builders.folders import object_record
from tests.builders.objects import ball


def test_an_object_reads_back_as_written(tmp_path: Path) -> None:
    complete = ball(400, 0.5)
    part = complete.select(complete.means[:, 0] > 0)
    written = write_object(tmp_path / "ball", object_record(), part, complete)
    found = read_object(tmp_path / "ball")
    assert found.record == written
    assert written.counts == {"sh_degree": 0, "partial": len(part), "complete": 400}
    torch.testing.assert_close(found.partial.means, part.means)
    for name, file in written.files.items():
        assert sha256_of(tmp_path / "ball" / name) == file.sha256
    assert sorted(os.listdir(tmp_path)) == ["ball"]


def test_the_same_object_is_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_object(tmp_path / name, object_record(), ball(400, 0.5), None)
    for file in sorted((tmp_path / "a").iterdir()):
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()


def test_nothing_is_replaced_without_overwrite(tmp_path: Path) -> None:
    folder = tmp_path / "ball"
    write_object(folder, object_record(), ball(300, 0.5), None)
    before = (folder / "partial.ply").read_bytes()
    with pytest.raises(UserError, match="--overwrite"):
        write_object(folder, object_record(), ball(400, 0.5), None)
    assert (folder / "partial.ply").read_bytes() == before
    write_object(folder, object_record(prompt="another"), ball(400, 0.5), None, overwrite=True)
    assert read_record(folder).prompt == "another"
    assert sorted(os.listdir(tmp_path)) == ["ball"]


def test_overwrite_replaces_nothing_but_object_folders(tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    (photos / "a.jpg").write_text("mine")
    said = r"photos: expected .*object\.json.*found other things \(such as a\.jpg\)"
    with pytest.raises(UserError, match=said):
        write_object(photos, object_record(), ball(400, 0.5), None, overwrite=True)
    options = ObjectOptions(out=photos, overwrite=True)
    with pytest.raises(UserError, match=said):
        check_out(options, tmp_path / "ball.ply")
    assert [path.read_text() for path in photos.iterdir()] == ["mine"]
    assert os.listdir(tmp_path) == ["photos"]


def test_a_folder_of_proposed_boxes_becomes_an_object(tmp_path: Path) -> None:
    (tmp_path / "ball").mkdir()
    (tmp_path / "ball/boxes.png").write_text("drawn by crop --propose")
    with pytest.raises(UserError, match="--overwrite"):
        write_object(tmp_path / "ball", object_record(), ball(400, 0.5), None)
    write_object(tmp_path / "ball", object_record(), ball(400, 0.5), None, overwrite=True)
    assert not (tmp_path / "ball/boxes.png").exists()
    assert read_record(tmp_path / "ball").id == "ball"


def test_a_failing_writer_leaves_the_old_folder(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a/old").write_text("old")

    def fail(temporary: Path) -> None:
        (temporary / "new").write_text("new")
        raise RuntimeError

    with (
        pytest.raises(RuntimeError),
        atomic_folder(tmp_path / "a", marker="old", overwrite=True) as temporary,
    ):
        fail(temporary)
    assert [p.name for p in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a/old").read_text() == "old"


def test_files_of_others_outlast_a_replaced_object(tmp_path: Path) -> None:
    folder = tmp_path / "ball"
    write_object(folder, object_record(), ball(300, 0.5), ball(400, 0.5))
    (folder / "notes.txt").write_text("mine")
    (folder / "photos").mkdir()
    (folder / "photos/a.txt").write_text("mine, too")
    write_object(folder, object_record(prompt="another"), ball(400, 0.5), None, overwrite=True)
    assert read_record(folder).prompt == "another"
    assert (folder / "notes.txt").read_text() == "mine"
    assert (folder / "photos/a.txt").read_text() == "mine, too"
    assert not (folder / "complete.ply").exists()


@pytest.mark.parametrize("overwrite", [False, True])
def test_what_appears_meanwhile_stays_and_so_does_what_was_written(
    tmp_path: Path, overwrite: bool
) -> None:
    place = tmp_path / "a"

    def write(temporary: Path) -> None:
        (temporary / "mark").write_text("new")
        place.mkdir()
        (place / "theirs").write_text("theirs")

    with (
        pytest.raises(UserError, match=r"what was to be written is in .*/a\."),
        atomic_folder(place, marker="mark", overwrite=overwrite) as temporary,
    ):
        write(temporary)
    assert (place / "theirs").read_text() == "theirs"
    (kept,) = (path for path in tmp_path.iterdir() if path != place)
    assert (kept / "mark").read_text() == "new"
    with atomic_folder(kept, marker="mark", overwrite=True) as temporary:
        (temporary / "mark").write_text("newer")
    assert (kept / "mark").read_text() == "newer"
    assert len(list(tmp_path.iterdir())) == 2


def test_leftovers_of_killed_writers_go(tmp_path: Path) -> None:
    (tmp_path / ".ball.abc_1234").mkdir()
    (tmp_path / ".bell.abc_1234").mkdir()
    (tmp_path / ".ball.backup").mkdir()
    (tmp_path / ".ball.a.file_123").write_text("")
    (tmp_path / ".build").mkdir()
    (tmp_path / "kept").mkdir()
    assert forget_leftovers(tmp_path, ["ball", "ball.a"]) == 1
    left = [".ball.a.file_123", ".ball.backup", ".bell.abc_1234", ".build", "kept"]
    assert sorted(os.listdir(tmp_path)) == left


def test_empty_and_unwritable_objects_are_user_errors(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no splats are left"):
        write_object(tmp_path / "x", object_record(), ball(0), None)
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "file", tmp_path / "file/below"):
        with pytest.raises(UserError, match="file"):
            write_object(place, object_record(), ball(400, 0.5), None)
    assert sorted(os.listdir(tmp_path)) == ["file"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 2}, "version"),
        ({"unknown": 1}, "unknown"),
        ({"prompt": " "}, "prompt"),
        ({"prompt": "\udcff"}, "prompt"),
        ({"prompt": "a \x1b[31mball"}, "prompt: expected a text without control characters"),
        ({"id": "../up"}, "id"),
        ({"subset": "video"}, "subset"),
        ({"views": {}}, "views"),
        ({"file_from_source": {"scale": 0}}, "file_from_source"),
    ],
)
def test_odd_records_name_file_and_field(tmp_path: Path, change: dict, message: str) -> None:
    write_object(tmp_path / "ball", object_record(), ball(400, 0.5), None)
    path = tmp_path / "ball/object.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(UserError, match=rf"object\.json.*{message}"):
        read_record(tmp_path / "ball")


numbers = st.floats(-5, 5, allow_nan=False)
positive = st.floats(0.01, 5)


@given(
    st.tuples(numbers, numbers, numbers),
    st.tuples(positive, positive, positive),
    st.tuples(numbers, numbers, numbers, st.floats(0.1, 3)),
)
def test_a_box_contains_what_its_axes_say(
    center: tuple[float, float, float],
    half: tuple[float, float, float],
    quaternion: tuple[float, float, float, float],
) -> None:
    box = CropBox(center, half, quaternion)
    points = np.random.default_rng(0).uniform(-8, 8, (200, 3))
    for point, inside in zip(points, box.contains(points), strict=True):
        offset = [float(np.dot(point - center, box.rotation[:, k])) for k in range(3)]
        margin = min(h - abs(o) for h, o in zip(half, offset, strict=True))
        if abs(margin) > 1e-9:
            assert inside == (margin > 0)


def test_boxes_apply_in_order_and_parse() -> None:
    points = np.array([[0, 0, 0], [2, 0, 0], [0.4, 0, 0], [np.nan, 0, 0]])
    first = parse_box("0,0,0,1,1,1")
    second = parse_box("keep:2,0,0,0.5,0.5,0.5,1,0,0,0")
    third = parse_box("remove:0.4,0,0,0.1,0.1,0.1")
    kept = inside_boxes(points, [first, second, third])
    assert kept.tolist() == [True, True, False, False]
    assert inside_boxes(points, [third]).tolist() == [True, True, False, True]
    for text in (
        "1,2,3",
        "drop:0,0,0,1,1,1",
        "0,0,0,1,1,0",
        "0,0,0,1,1,nan",
        "0,0,0,1,1,1,0,0,0,0",
    ):
        with pytest.raises(UserError, match="--box"):
            parse_box(text)
