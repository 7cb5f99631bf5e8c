"""Which axis of a mesh file points up, as its format says.

Conventions
-----------
* glTF defines Y as up. COLLADA files say it themselves (``up_axis``), and those that do not have
  Y up. All others say nothing; Z is assumed, as in CAD and robotics.
* Reading turns nothing: ``load`` keeps a file's own axes, and trimesh applies no ``up_axis``.
"""

from __future__ import annotations

import re
from pathlib import Path

from gscomplete.views import UpAxis
from splatcomplete_data.mesh.files.file_checks import GLTF_SUFFIXES
from splatcomplete_data.mesh.files.side_files import read_text

UP_SAYING_SUFFIXES = (*GLTF_SUFFIXES, ".dae")
"""Suffixes of the formats that say what is up."""
_COLLADA_UP = re.compile(r"<(?:\w+:)?up_axis>\s*([XYZ])_UP\s*<")
_COLLADA_AXES: dict[str, UpAxis] = {"X": "X", "Y": "Y", "Z": "Z"}


def up_of_mesh_file(path: Path) -> UpAxis:
    """Return the axis that points up in a mesh file (module conventions); it may be missing."""
    suffix = path.suffix.lower()
    if suffix in GLTF_SUFFIXES:
        return "Y"
    if suffix == ".dae" and path.is_file():
        found = _COLLADA_UP.search(read_text(path))
        return "Y" if found is None else _COLLADA_AXES[found[1]]
    return "Z"
