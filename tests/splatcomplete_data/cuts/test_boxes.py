"""Boxes as text and in files; what they keep is tested with the objects that record them."""

import numpy as np
import pytest

from gscomplete.errors import UserError
from splatcomplete_data.cuts.boxes import CropBox, box_text, parse_box, read_boxes

TEXTS = ["0,0,0,1,1,1", "remove:0.4,0,0,0.1,0.2,0.3,0.5,0.5,0.5,0.5"]


def test_a_file_holds_a_box_a_line(tmp_path):
    path = tmp_path / "boxes.txt"
    path.write_text("\n".join(["", *TEXTS, ""]))
    boxes = [parse_box(text) for text in TEXTS]
    assert read_boxes(str(path)) == boxes
    assert [box for text in TEXTS for box in read_boxes(text)] == boxes
    assert [box_text(box) for box in boxes] == TEXTS


def test_boxes_far_from_the_origin_are_written_as_precisely_as_others():
    """Coordinates of a survey, in metres."""
    box = CropBox((412_345.6789, 5_712_345.6789, 12.3456), (0.25, 0.5, 1.0))
    again = parse_box(box_text(box))
    assert np.abs(np.subtract(again.center, box.center)).max() < 1e-5
    assert again.half_extents == box.half_extents


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\n\n", "expected a box a line, found none"),
        (b"0,0,0,1,1,1\n\n1,2\n", "line 3: expected"),
        (b"\xff\xfe", "cannot be read"),
        (None, "cannot be read"),
    ],
)
def test_files_that_hold_no_boxes_are_refused(tmp_path, content, message):
    path = tmp_path / "boxes.txt"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UserError, match=message):
        read_boxes(str(path))
