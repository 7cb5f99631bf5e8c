"""Rows of text: a header says which columns are colours, else their numbers do; a note tells."""

from pathlib import Path

import numpy as np
import pytest

from gscomplete.errors import UserError
from splatcomplete_data.scan.cloud import GREY
from splatcomplete_data.scan.read import Scan, read_scan

RNG = np.random.default_rng(0)
COUNT = 50
POINTS = RNG.uniform(-1, 1, (COUNT, 3)).round(3)
BYTES = RNG.integers(0, 256, (COUNT, 3))
BYTES[0] = [255, 128, 0]
"""The largest byte occurs, so colours are shares of 255."""
NORMALS = np.tile([0, 0, 1], (COUNT, 1))
"""Those of a flat floor: whole numbers, none of them negative."""
INTENSITY = RNG.integers(1000, 60000, (COUNT, 1))


def written(path: Path, *columns: np.ndarray, header: str = "", separator: str = " ") -> Scan:
    table = np.concatenate(columns, axis=1)
    rows = [separator.join(f"{value:.6g}" for value in row) for row in table]
    path.write_text("\n".join([header, *rows]) + "\n")
    return read_scan(path)


def is_colored(scan: Scan) -> bool:
    """Whether points and colours are those written; a cloud that is neither so nor grey fails."""
    np.testing.assert_allclose(scan.cloud.points, POINTS, atol=1e-6)
    if (scan.cloud.colors == np.float32(GREY)).all():
        return False
    np.testing.assert_allclose(scan.cloud.colors, BYTES / 255, atol=1e-6)
    return True


@pytest.mark.parametrize(
    ("header", "separator"),
    [
        ("//X Y Z R G B Intensity", " "),
        ("# x y z r g b i", "\t"),
        ("x,y,z,red,green,blue,intensity", ","),
        ('"X";"Y";"Z";"Rf";"Gf";"Bf";"Scalar field"', ";"),
        ("X (m),Y (m),Z (m),Color_R,Color_G,Color_B,Intensity [-]", ","),
    ],
)
def test_a_header_says_which_columns_are_colours(tmp_path, header, separator):
    path = tmp_path / "a.csv"
    scan = written(path, POINTS, BYTES, INTENSITY, header=header, separator=separator)
    assert is_colored(scan)
    assert scan.notes == ("colour from columns 4, 5, 6, by their names in the header",)


def test_a_header_may_have_another_order_and_a_count_below(tmp_path):
    header = f"//B G R Z Y X\n{COUNT}"
    scan = written(tmp_path / "a.asc", BYTES[:, ::-1], POINTS[:, ::-1], header=header)
    assert is_colored(scan)


def test_an_index_column_without_a_name_is_no_coordinate(tmp_path):
    index = np.arange(COUNT)[:, None]
    header = ",x,y,z,r,g,b"
    scan = written(tmp_path / "a.csv", index, POINTS, BYTES, header=header, separator=",")
    assert is_colored(scan)


@pytest.mark.parametrize("names", ["nx ny nz", "a b c", "intensity class time"])
def test_a_header_without_colours_leaves_points_grey(tmp_path, names):
    scan = written(tmp_path / "a.xyz", POINTS, BYTES, header=f"# x y z {names}")
    assert not is_colored(scan)
    found = ", ".join(["x", "y", "z", *names.split()])
    assert scan.notes == (f"no colour: grey (the header names {found})",)


@pytest.mark.parametrize(
    ("columns", "note"),
    [
        ((POINTS,), "no colour: grey"),
        ((POINTS, INTENSITY), "no colour: grey"),
        ((POINTS, NORMALS), "no colour: grey; columns 4 to 6 taken for normals (unit length)"),
        (
            (POINTS, INTENSITY, NORMALS),
            "no colour: grey; columns 5 to 7 taken for normals (unit length)",
        ),
        ((POINTS, BYTES), "columns 4 to 6 (whole numbers up to 255); a header"),
        ((POINTS, INTENSITY, BYTES), "columns 5 to 7 (whole numbers up to 255); a header"),
        ((POINTS, BYTES, INTENSITY), "columns 4 to 6 (whole numbers up to 255); a header"),
        ((POINTS, BYTES, INTENSITY / 60000), "columns 4 to 6 (whole numbers up to 255)"),
        ((POINTS, BYTES, -INTENSITY), "columns 4 to 6 (whole numbers up to 255)"),
        ((POINTS, BYTES / 255), "columns 4 to 6 (numbers from 0 to 1)"),
        ((POINTS, BYTES * 257), "columns 4 to 6 (whole numbers up to 65535)"),
        ((POINTS, BYTES, NORMALS), "columns 4 to 6 (whole numbers up to 255); columns 7 to 9"),
        ((POINTS, NORMALS, BYTES), "columns 7 to 9 (whole numbers up to 255); columns 4 to 6"),
        ((POINTS, INTENSITY / 7, BYTES, INTENSITY / 7), "columns 5 to 7 (whole numbers up to 255)"),
    ],
)
def test_without_a_header_the_numbers_say_what_is_a_colour(tmp_path, columns, note):
    scan = written(tmp_path / "a.xyz", *columns)
    assert is_colored(scan) == ("no colour" not in note)
    assert note in scan.notes[0]


def test_numbers_that_are_no_colour_are_taken_only_where_rows_end_in_one(tmp_path):
    halves = RNG.uniform(0, 255, (COUNT, 3))
    assert written(tmp_path / "a.xyz", POINTS, halves).cloud.colors.std() > 0.1
    wide = written(tmp_path / "b.xyz", POINTS, halves, halves)
    assert (wide.cloud.colors == np.float32(GREY)).all()
    assert wide.notes == ("no colour: grey",)


def test_a_header_that_does_not_fit_the_rows_is_noted(tmp_path):
    scan = written(tmp_path / "a.xyz", POINTS, BYTES, header="# x y z r g b i")
    assert is_colored(scan)
    assert "the header is not used: it names 7 columns, rows have 6" in scan.notes[0]


def test_semicolons_free_the_comma_for_decimals(tmp_path):
    (tmp_path / "a.csv").write_text("x;y;z\n0,5;-1,25;3\n;;\n1;2;3,5\n")
    np.testing.assert_allclose(
        read_scan(tmp_path / "a.csv").cloud.points, [[0.5, -1.25, 3], [1, 2, 3.5]]
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("1 2\n", "found 2"),
        ("1 2 3\n1 2 3 4\n", "found 3 and 4"),
        ("# x y z\n", "found none"),
        ("a letter\nto a\nfriend\n1 2 3\n", "found 'a letter' before the first row"),
        ("1 2 3\n1 2 b\n", "expected numbers"),
        ("# x y z\n\n1 2 3\n\n1 2\n", ":5: expected rows of equal length"),
        ("1 2 3\n# a remark\n1 2 b\n", ":3: expected numbers, found '1 2 b'"),
    ],
)
def test_other_texts_are_named(tmp_path, content, message):
    (tmp_path / "a.txt").write_text(content)
    with pytest.raises(UserError, match=rf"a\.txt.*{message}"):
        read_scan(tmp_path / "a.txt")
