"""Names say which files hold splats, and which names may be those of folders."""

from pathlib import Path

import pytest

from gscomplete.errors import UserError
from gscomplete.splats.formats.any_file import READ
from gscomplete.util.file_names import (
    SPLAT_SUFFIXES,
    is_plain_name,
    require_destination,
    shown_name,
    splat_stem,
)


def test_the_suffixes_are_those_of_the_formats_that_are_read():
    assert {f".{kind}" for kind in READ} == set(SPLAT_SUFFIXES)


@pytest.mark.parametrize(
    ("name", "stem"),
    [
        ("mug.ply", "mug"),
        ("mug.v2.compressed.ply", "mug.v2"),
        ("MUG.SPZ", "MUG"),
        ("mug.obj", None),
        ("._mug.ply", None),
        (".ply", None),
        ("mug", None),
    ],
)
def test_stems(name, stem):
    assert splat_stem(name) == stem


def test_plain_names_stay_within_their_folder():
    assert all(map(is_plain_name, ("mug", "a mug", "mug.v2", "Krug_für_2", "茶杯")))
    odd = ("", ".mug", "..", "a/b", "../../evil", "a\\b", "a\0", "a\nb", "a\tb", "a" * 201, 3, None)
    assert not any(map(is_plain_name, odd))


def test_a_file_to_be_replaced_has_to_be_named_as_one_of_its_kind():
    for path in (None, Path("a.csv"), Path("A.CSV")):
        require_destination("--csv", path, (".csv",))
    for name in ("mug.ply", "mug", ".csv", "csv"):
        with pytest.raises(UserError, match=r"--csv: expected a file name ending in \.csv, found"):
            require_destination("--csv", Path(name), (".csv",))


def test_bytes_that_are_no_text_are_shown_as_such():
    assert shown_name("n\udcff ж.ply") == "n\ufffd ж.ply"
    assert is_plain_name(shown_name("n\udcff"))
