"""Aliases are followed, unless one stands for itself or a few stand for billions of values."""

from pathlib import Path

import pytest

from gscomplete.errors import UserError
from splatcomplete_data.cli import main
from splatcomplete_data.dataset.plain_yaml import read_yaml

HEAD = "schema: splatcomplete.recipe\nversion: 1\n"


def bomb(last: str, item: str) -> str:
    """Nine levels of nine aliases each; ``item`` makes one level of nine aliases of the last."""
    lines = ["l0: &l0 {a: 1}"]
    for level in range(9):
        inner = ", ".join([f"*l{level}"] * 9)
        lines.append(f"l{level + 1}: &l{level + 1} " + item.format(inner))
    return "\n".join(lines) + f"\n{last}: *l9\n"


def test_aliases_and_merge_keys_are_followed(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("a: &a {x: 1, y: [2, &three 3]}\nb: {<<: *a, x: *three}\nc: [*a, *a]\n")
    first = {"x": 1, "y": [2, 3]}
    assert read_yaml(path, "tests") == {"a": first, "b": first | {"x": 3}, "c": [first, first]}
    path.write_text("")
    assert read_yaml(path, "tests") is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("objects:\n- &a {id: a, command: mesh, file: *a}\n", r"objects\[0\]\.file \(line 4\)"),
        ("objects: [{id: a, command: mesh, file: x, cut: &b [*b]}]\n", r"objects\[0\]\.cut\[0\]"),
        ("objects: &a\n  <<: *a\n", r"objects\.<<"),
        ("? &k [*k]\n: 1\n", r"\?\[0\]"),
        ("schema: &s [*s]\n", r"schema\[0\]"),
        ("objects: [{id: a, id: b}]\n", r"objects\[0\] \(line 3\): .* found 'id' again"),
        ("objects: []\nversion: 2\n", r"the top level \(line 4\): .* found 'version' again"),
        (bomb("version", "[{}]"), r"l\d.* expected at most"),
        (bomb("objects", "{{<<: [{}]}}"), r"l\d.* expected at most"),
    ],
)
def test_aliases_of_themselves_or_of_too_much_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    path = tmp_path / "recipe.yaml"
    path.write_text(HEAD + text)
    with pytest.raises(UserError, match=rf"recipe\.yaml: {message}"):
        read_yaml(path, "tests")
    assert main(["build", str(path), "--data", str(tmp_path), "--out", str(tmp_path / "o")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_what_is_no_yaml_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    for content, message in ((b"[", "expected YAML"), (b"\xff", "cannot read it")):
        path.write_bytes(content)
        with pytest.raises(UserError, match=rf"a\.yaml: {message}"):
            read_yaml(path, "tests")
    with pytest.raises(UserError, match=r"none\.yaml: cannot read it"):
        read_yaml(tmp_path / "none.yaml", "tests")
