"""Damage to values as JSON and YAML have them."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import numpy as np

ODD_VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2, 255, 65536, 2**31, 2**63, 10**30, -(10**9)),
    *(0.5, -0.0, 1e-300, 1e39, 1e308, float("nan"), float("inf"), float("-inf")),
    *("", " ", "x", "0", "NaN", "../x", "/dev/zero", "\0", "\u00a0", "\ud800", "x" * 300),
    *([], {}, [[]], [None], [0] * 40, {"": None}, {"x": {"x": {}}}),
)
"""Of every type, and beyond every bound."""


def damage_tree(value: Any, rng: np.random.Generator) -> Any:
    """Return a copy of a value with one to three places replaced, removed, renamed or doubled.

    Args:
        value: of dictionaries, lists, texts and numbers; it is not changed.
        rng: says where and how.
    """
    root = [copy.deepcopy(value)]
    for _ in range(int(rng.integers(1, 4))):
        places = list(_places(root))
        holder, key = places[int(rng.integers(len(places)))]
        kind = int(rng.integers(6))
        if kind <= 2 or holder is root:
            holder[key] = copy.deepcopy(ODD_VALUES[int(rng.integers(len(ODD_VALUES)))])
        elif kind == 3:
            del holder[key]
        elif kind == 4:
            other, place = places[int(rng.integers(len(places)))]
            holder[key] = copy.deepcopy(other[place])
        elif isinstance(holder, dict):
            holder[f"{key}_"] = holder.pop(key)
        else:
            holder[key:key] = [copy.deepcopy(holder[key])] * int(rng.integers(1, 5))
    return root[0]


def _places(holder: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every place below a dictionary or list, as (what holds it, key or index)."""
    keys = list(holder) if isinstance(holder, dict) else range(len(holder))
    for key in keys:
        yield holder, key
        if isinstance(holder[key], dict | list):
            yield from _places(holder[key])
