"""Dataclasses survive JSON; anything unexpected is named."""

import dataclasses
import json
from datetime import date
from pathlib import Path
from typing import Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gscomplete.errors import UserError
from gscomplete.util import jsonio


@dataclasses.dataclass(frozen=True)
class Inner:
    numbers: tuple[float, float, float]
    names: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Outer:
    inner: Inner
    count: int
    ratio: float
    path: Path
    mode: Literal["fast", "slow"]
    on: bool
    limit: float | None = None
    table: dict[str, int] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.count < 0:
            raise ValueError(f"count: expected 0 or more, found {self.count}")


def example(**changes: Any) -> Outer:
    inner = Inner((1.0, -2.5, 1e300), ("a", "ä"))
    outer = Outer(inner, 3, 0.1, Path("a/b"), "fast", True, None, {"x": 1})
    return dataclasses.replace(outer, **changes)


finite = st.floats(allow_nan=False, allow_infinity=False)


@given(finite, st.integers(0, 2**70), st.none() | finite, st.booleans())
def test_round_trip_keeps_every_bit(
    ratio: float, count: int, limit: float | None, on: bool
) -> None:
    value = example(ratio=ratio, count=count, limit=limit, on=on)
    assert jsonio.from_json(Outer, json.loads(jsonio.dumps(value)), "x.json") == value


def test_integers_are_accepted_as_floats() -> None:
    data = jsonio.to_json(example()) | {"ratio": 2}
    ratio = jsonio.from_json(Outer, data, "x.json").ratio
    assert ratio == 2.0
    assert isinstance(ratio, float)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"colour": 1}, ["unknown field 'colour'", "x.json"]),
        ({"count": 1.5}, ["count", "an integer", "1.5"]),
        ({"count": True}, ["count", "an integer"]),
        ({"count": -1}, ["count", "0 or more", "-1"]),
        ({"ratio": "a"}, ["ratio", "number", '"a"']),
        ({"ratio": float("nan")}, ["ratio", "finite"]),
        ({"on": 1}, ["on", "true or false"]),
        ({"mode": "medium"}, ["mode", "'fast', 'slow'", '"medium"']),
        ({"limit": "none"}, ["limit", "number"]),
        ({"inner": 3}, ["inner", "an object", "3"]),
        ({"inner": {"numbers": [1, 2], "names": []}}, ["inner.numbers", "3 values", "2"]),
        ({"inner": {"numbers": [1, 2, "c"], "names": []}}, ["inner.numbers[2]"]),
        ({"inner": {"numbers": [1, 2, 3]}}, ["inner", "missing field 'names'"]),
        ({"table": {"x": "y"}}, ["table.x", "an integer"]),
    ],
)
def test_errors_name_file_field_expected_and_found(
    change: dict[str, Any], words: list[str]
) -> None:
    data = jsonio.to_json(example()) | change
    with pytest.raises(UserError) as caught:
        jsonio.from_json(Outer, data, "x.json")
    for word in words:
        assert word in str(caught.value)


def test_missing_field_is_named() -> None:
    data = jsonio.to_json(example())
    del data["ratio"]
    with pytest.raises(UserError, match="missing field 'ratio'"):
        jsonio.from_json(Outer, data, "x.json")


def test_values_without_a_json_form_are_refused() -> None:
    with pytest.raises(TypeError, match="finite"):
        jsonio.to_json({"a": [float("inf")]})
    with pytest.raises(TypeError, match="object"):
        jsonio.to_json(object())


def test_files_round_trip_and_errors_name_them(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    jsonio.write_json(path, example())
    assert jsonio.from_json(Outer, jsonio.read_json(path), str(path)) == example()
    path.write_text("{'a': 1}")
    with pytest.raises(UserError, match=r"x\.json.*expected JSON.*line 1"):
        jsonio.read_json(path)
    with pytest.raises(UserError, match=r"none\.json.*cannot read"):
        jsonio.read_json(tmp_path / "none.json")
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UserError, match="cannot read"):
        jsonio.read_json(path)


@pytest.mark.parametrize("text", ["1" + "0" * 400, "9" * 5000, "[" * 100_000])
def test_numbers_and_nesting_beyond_all_bounds_are_user_errors(tmp_path: Path, text: str) -> None:
    path = tmp_path / "x.json"
    path.write_text(json.dumps(jsonio.to_json(example())).replace("0.1", text, 1))
    if text not in path.read_text():
        path.write_text('{"ratio": ' + text + "}")
    with pytest.raises(UserError, match=r"x\.json"):
        jsonio.from_json(Outer, jsonio.read_json(path), str(path))


def test_dates_of_yaml_are_shown():
    with pytest.raises(UserError, match='count: expected an integer, found "2026-01-31"'):
        jsonio.from_json(Outer, jsonio.to_json(example()) | {"count": date(2026, 1, 31)}, "a.yaml")


def test_values_that_hold_themselves_are_described():
    held: list = []
    held.append(held)
    with pytest.raises(UserError, match="count: expected an integer, found a list that cannot"):
        jsonio.from_json(Outer, jsonio.to_json(example()) | {"count": held}, "a.yaml")


def test_names_that_are_no_text_are_kept(tmp_path: Path) -> None:
    """Python gives a byte of a file name that is not UTF-8 as a lone surrogate."""
    value = example(path=Path("\udcff ж"))
    jsonio.write_json(tmp_path / "a.json", value)
    assert r'"\udcff ж"' in (tmp_path / "a.json").read_text(encoding="utf-8")
    assert jsonio.from_json(Outer, jsonio.read_json(tmp_path / "a.json"), "a.json") == value
