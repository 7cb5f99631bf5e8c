"""The page on which boxes are chosen, driven as a browser drives it."""

import dataclasses
import math
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

from gscomplete.errors import UserError
from splatcomplete_data.cuts.box_page import PickedPoints, pick_boxes
from splatcomplete_data.cuts.boxes import CropBox, inside_boxes, read_boxes

POINTS = np.random.default_rng(0).uniform(-1, 1, (2000, 3))
COLORS = np.full((2000, 3), 0.25, np.float32)
PALE_BLUE = 150
TURN = CropBox((0.1, 0.2, 0.3), (0.4, 0.3, 0.2), (math.cos(0.3), 0.0, 0.0, math.sin(0.3)))


@pytest.fixture
def start(tmp_path):
    pytest.importorskip("viser")
    pages, told = [], []

    def started(*boxes: CropBox, points=POINTS):
        picked = PickedPoints(points, COLORS, (0.0, 0.0, 1.0))
        path = tmp_path / "boxes.txt"
        pages.append(pick_boxes(picked, boxes, path, "crop scene.ply", told.append, port=18090))
        return pages[-1], told

    yield started
    for page in pages:
        page.server.stop()


def click(page, label):
    for callback in page.controls[label]._impl.update_cb:
        callback(None)


def test_the_page_starts_with_the_given_boxes_or_one_about_the_middle(start):
    page, _ = start(TURN)
    assert page.boxes == [TURN]
    assert tuple(page.nodes["gizmo"].position) == TURN.center
    assert tuple(page.nodes["gizmo"].wxyz) == pytest.approx(TURN.quaternion)
    assert [page.controls[axis].value for axis in "xyz"] == list(TURN.half_extents)
    alone, _ = start()
    (box,) = alone.boxes
    assert np.abs(box.center).max() < 0.1
    assert len(set(box.half_extents)) == 1


def test_what_is_kept_is_counted_and_has_its_own_colours(start):
    page, _ = start(TURN)
    kept = inside_boxes(POINTS, [TURN])
    assert f"keeps {kept.sum():,} of 2,000" in page.controls["count"].content
    blue = np.asarray(page.nodes["points"].colors)[:, 2]
    assert ((blue < PALE_BLUE) == kept).all()


def test_gizmo_sliders_and_buttons_change_the_boxes(start):
    page, _ = start(TURN)
    page.controls["x"].value = 0.5
    assert page.boxes[0].half_extents == pytest.approx((0.5, 0.3, 0.2), abs=2e-3)
    click(page, "add a box to remove")
    assert [box.action for box in page.boxes] == ["keep", "remove"]
    assert page.chosen == 1
    gizmo = page.nodes["gizmo"]
    gizmo.position = (0.5, 0.0, 0.0)
    for callback in gizmo._impl_aux.update_cb:
        callback(SimpleNamespace(phase="end"))
    assert page.boxes[1].center == (0.5, 0.0, 0.0)
    assert page.boxes[0].center == TURN.center
    page.controls["box"].value = "1: keep"
    assert page.chosen == 0
    assert tuple(gizmo.position) == TURN.center
    click(page, "delete this box")
    click(page, "delete this box")
    assert [box.action for box in page.boxes] == ["remove"]  # the last one stays


def test_what_is_saved_is_what_the_option_reads(start, tmp_path):
    page, told = start(TURN, CropBox((0.0, 0.0, 0.5), (0.1, 0.2, 0.3), action="remove"))
    click(page, "save")
    path = tmp_path / "boxes.txt"
    assert told == [f"crop scene.ply --box {path}"]
    read = read_boxes(str(path))
    assert [box.action for box in read] == ["keep", "remove"]
    for one, other in zip(read, page.boxes, strict=True):
        for name in ("center", "half_extents", "quaternion"):
            assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-5)
    assert (inside_boxes(POINTS, read) == inside_boxes(POINTS, page.boxes)).mean() > 0.999


def test_survey_coordinates_are_drawn_finely_and_saved_exactly(start, tmp_path):
    """Steps of float32 are 0.03 at the first coordinate and 0.5 at the second."""
    far = np.array([500_000.0, 5_400_000.0, 120.0])
    center = tuple(np.add(far, (0.123456, -0.2, 0.3)).tolist())
    box = dataclasses.replace(TURN, center=center)
    page, _ = start(box, points=POINTS + far)
    drawn = np.asarray(page.nodes["points"].points, np.float64)
    assert np.abs(drawn + page.offset - (POINTS + far)).max() < 1e-6
    near, _ = start(dataclasses.replace(TURN, center=tuple(np.subtract(center, far).tolist())))
    assert page.controls["count"].content == near.controls["count"].content
    edges = [np.asarray(one.nodes["/boxes/0"].points, np.float64) for one in (page, near)]
    assert np.abs(edges[0] + page.offset - far - edges[1]).max() < 1e-6
    click(page, "save")
    (read,) = read_boxes(str(tmp_path / "boxes.txt"))
    assert read.center == center  # to the last of the digits that the box was given with
    gizmo = page.nodes["gizmo"]
    assert tuple(gizmo.position) == tuple(np.subtract(center, page.offset).tolist())
    gizmo.position = tuple(np.add(gizmo.position, (0.001, 0.0, 0.0)).tolist())
    for callback in gizmo._impl_aux.update_cb:
        callback(SimpleNamespace(phase="end"))
    moved = np.subtract(page.boxes[0].center, center)
    assert np.abs(moved - [0.001, 0.0, 0.0]).max() < 1e-8


def test_callbacks_of_many_threads_wait_for_each_other(start):
    """As viser calls them while the gizmo is dragged."""
    page, _ = start(TURN, dataclasses.replace(TURN, action="remove"))
    (moved,) = page.nodes["gizmo"]._impl_aux.update_cb
    with ThreadPoolExecutor(8) as threads:
        calls = [threads.submit(moved, SimpleNamespace(phase="update")) for _ in range(200)]
    for call in calls:
        call.result()
    lines = [name for name in page.nodes if name.startswith("/boxes/")]
    assert sorted(lines) == ["/boxes/0", "/boxes/1"]


def test_what_cannot_be_saved_is_told(start, tmp_path):
    page, told = start(TURN)
    page.path = tmp_path / "nowhere/boxes.txt"
    click(page, "save")
    assert len(told) == 1
    assert told[0].startswith("not saved: ")
    assert "the folder does not exist" in told[0]
    assert told[0] in page.controls["saved"].content


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((4, 3), np.nan)])
def test_a_scene_of_nothing_is_refused(tmp_path, points):
    picked = PickedPoints(points, np.zeros((len(points), 3), np.float32), (0.0, 0.0, 1.0))
    with pytest.raises(UserError, match="expected points to choose boxes in, found none"):
        pick_boxes(picked, [], tmp_path / "boxes.txt", "scan a.pcd", print)
