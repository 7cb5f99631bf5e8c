"""The command line reads what a user means."""

from pathlib import Path

import pytest

from splatcomplete_data.cli import main
from splatcomplete_data.cli.program import gathered


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
        ("partial --cut=x a", "partial a --cut x"),
        ("depth --box=1 a b --out c --box=2", "depth a b --box 1 2 --out c"),
        ("crop --json --box=1 --box 2 3 --up=Z a", "crop --json --box 1 2 3 --up=Z a"),
        ("partial --cut x --box=1 a", "partial a --cut x --box 1"),
        ("", ""),
    ],
)
def test_repeated_list_options_add_up(words: str, expected: str) -> None:
    assert gathered(words.split()) == expected.split()


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        ("partial --cut plane:0 cup --out a", "put it before --cut"),
        ("partial --cut plane:0 --out a", None),
        ("partial --subset sideways cup", None),
    ],
)
def test_a_list_that_took_the_file_is_named(
    capsys: pytest.CaptureFixture[str], words: str, hint: str | None
) -> None:
    with pytest.raises(SystemExit) as refusal:
        main(words.split())
    assert refusal.value.code == 2
    said = capsys.readouterr().err
    assert hint in said if hint else "put it before" not in said


def test_a_file_behind_a_list_with_an_equals_sign_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["crop", "--box=auto", str(tmp_path / "none.ply")]) == 2
    assert "none.ply: cannot read" in capsys.readouterr().err
