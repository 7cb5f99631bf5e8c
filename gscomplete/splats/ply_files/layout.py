"""Where the splat values sit in a vertex record.

Conventions
-----------
* Schema of the original 3DGS: ``x y z``, ``f_dc_0..2``, ``f_rest_0..``, ``opacity``,
  ``scale_0..2``, ``rot_0..3`` (w, x, y, z), in any order, among any other properties.
* ``f_rest`` is channel-major: all higher coefficients of red, then green, then blue.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from gscomplete.splats.ply_files.header import Element, PlyError

REQUIRED = (
    *("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)
"""Properties without which there are no splats."""

_HIGHER_PER_CHANNEL = {0: 0, 9: 3, 24: 8, 45: 15, 72: 24}


@dataclass(frozen=True, slots=True)
class SplatLayout:
    """Indices of the splat properties within a vertex record."""

    means: tuple[int, ...]  # 3
    sh: tuple[int, ...]  # 3 K: f_dc and f_rest in the order of Splats.sh, channels innermost
    opacity: int
    scales: tuple[int, ...]  # 3
    quaternion: tuple[int, ...]  # 4
    foreign: tuple[str, ...]  # names of all other properties
    integer: tuple[str, ...]  # names of splat properties of an integer type
    dropped_bands: bool  # True when the file has SH above degree 3

    @property
    def coefficients(self) -> int:
        """Number K of SH coefficients per channel that are read."""
        return len(self.sh) // 3


def find_layout(element: Element, path: Path) -> SplatLayout:
    """Find the splat properties of a vertex element.

    Raises:
        PlyError: a property is missing, doubled or a list, or ``f_rest`` has a wrong count.
    """
    names = element.names
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        kind = describe_vertices(names)
        message = (
            f"element vertex: expected the properties {', '.join(REQUIRED)}; "
            f"missing {', '.join(missing)}{kind}"
        )
        none_of_ours = len(missing) > len(REQUIRED) - 4  # at most x, y, z are there
        raise PlyError(path, "not_a_splat_file" if none_of_ours else "missing_property", message)
    rest_count = _count_higher(names)
    if rest_count not in _HIGHER_PER_CHANNEL:
        counts = ", ".join(str(count) for count in _HIGHER_PER_CHANNEL)
        message = f"element vertex: expected {counts} f_rest properties, found {rest_count}"
        raise PlyError(path, "sh_layout", message)
    index = _index_properties(element, path, rest_count)
    per_channel = _HIGHER_PER_CHANNEL[rest_count]
    kept = min(per_channel, 15)
    return SplatLayout(
        means=tuple(index[name] for name in "xyz"),
        sh=tuple(index[f"f_dc_{c}"] for c in range(3))
        + tuple(index[f"f_rest_{c * per_channel + k}"] for k in range(kept) for c in range(3)),
        opacity=index["opacity"],
        scales=tuple(index[f"scale_{i}"] for i in range(3)),
        quaternion=tuple(index[f"rot_{i}"] for i in range(4)),
        foreign=tuple(name for name in names if name not in index),
        integer=tuple(n for n, i in index.items() if element.properties[i].code[0] in "iu"),
        dropped_bands=per_channel > kept,
    )


def _index_properties(element: Element, path: Path, rest_count: int) -> dict[str, int]:
    """Places of the splat properties by name; each must be there once and be a number."""
    names = element.names
    rest_names = [f"f_rest_{i}" for i in range(rest_count)]
    index: dict[str, int] = {}
    for name in (*REQUIRED, *rest_names):
        places = [i for i, found in enumerate(names) if found == name]
        if len(places) != 1:
            message = f"element vertex: property {name}: expected once, found {len(places)} times"
            raise PlyError(path, "missing_property" if not places else "bad_header", message)
        index[name] = places[0]
    for prop in element.properties:
        if prop.count_code is not None:
            message = f"element vertex: property {prop.name}: expected a number, found a list"
            raise PlyError(path, "mistyped_property", message)
    return index


def _count_higher(names: list[str]) -> int:
    """Number of ``f_rest`` properties that the highest index among them implies."""
    found = [name.removeprefix("f_rest_") for name in names if name.startswith("f_rest_")]
    indices = [int(text) for text in found if re.fullmatch("[0-9]{1,9}", text)]
    implied = max(indices, default=-1) + 1
    return implied if implied in _HIGHER_PER_CHANNEL else len(found)


def describe_vertices(names: list[str]) -> str:
    """Say what vertices without splat properties look like; empty when unknown."""
    if "packed_position" in names:
        return " (a SuperSplat compressed PLY)"
    if "red" in names or "diffuse_red" in names:
        return " (it looks like a coloured point cloud or mesh, not splats)"
    if "opacity" not in names and "f_dc_0" not in names:
        return " (it looks like a point cloud or mesh, not splats)"
    return ""
