"""Names say which files hold splats."""

import pytest

from gscomplete.splats.formats.any_file import READ
from gscomplete.util.file_names import SPLAT_SUFFIXES, splat_stem


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
