"""The command line reads what a user means."""

import pytest

from splatcomplete_data.cli import gathered


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("crop a --box 1 --box 2", "crop a --box 1 2"),
        (
            "crop a --box -1,0 2 --out b --box=remove:3 --json",
            "crop a --box -1,0 2 remove:3 --out b --json",
        ),
        ("partial a --cut x --box 1 --cut y --box 2", "partial a --cut x y --box 1 2"),
        ("crop a --box", "crop a --box"),
        ("mesh a --cut x --count 3 --cut y b", "mesh a --cut x y b --count 3"),
        ("", ""),
    ],
)
def test_repeated_list_options_add_up(words: str, expected: str) -> None:
    assert gathered(words.split()) == expected.split()
