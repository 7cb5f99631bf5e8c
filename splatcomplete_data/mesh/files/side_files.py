r"""Files that a mesh file names: material libraries, textures, buffers.

Conventions
-----------
* Names are relative to the file that holds them, with ``/`` or ``\``, quoted or percent-encoded,
  with or without ``file://``, as exporters write them.
* Only the mesh's own text and its material libraries within reach (``named_files``) are read; a
  file that is not there, or may not be read, is listed all the same.
* An OBJ may name several material libraries, in lines of their own or in one.
"""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import unquote

from splatcomplete_data.named_files import Reach

_MTL_MAPS = re.compile(
    r"^\s*(?:map_\w+|bump|disp|decal|refl|norm)\s+(.+?)\s*$", re.MULTILINE | re.IGNORECASE
)
_MTL_LIBRARIES = re.compile(r"^\s*mtllib\s+(.+?)\s*$", re.MULTILINE)
_LIBRARY_NAMES = re.compile(r"\S.*?\.mtl(?=\s|$)", re.IGNORECASE)
_GLTF_URIS = re.compile(r'"uri"\s*:\s*"(?!data:)([^"]+)"')
_DAE_IMAGES = re.compile(r"<init_from>\s*(?:<ref>)?\s*([^<\s][^<]*?\.\w{3,4})\s*<")
_PLY_TEXTURES = re.compile(r"^comment\s+TextureFile\s+(.+?)\s*$", re.MULTILINE)
_PLY_HEAD_BYTES = 4096


def side_files(path: Path, reach: Reach | None = None) -> dict[str, Path]:
    """Return the files that a mesh file names, by the names in it, in order.

    Args:
        path: a mesh file; any other file, or none, names nothing.
        reach: where material libraries are read; None = below the mesh's folder.

    Raises:
        OSError: the file cannot be read.
    """
    suffix = path.suffix.lower()
    if not path.is_file():
        return {}
    if suffix in (".gltf", ".glb"):
        return _found(path, _GLTF_URIS.findall(gltf_text(path)))
    if suffix == ".dae":
        return _found(path, _DAE_IMAGES.findall(read_text(path)))
    if suffix == ".ply":
        with path.open("rb") as stream:
            head = stream.read(_PLY_HEAD_BYTES).partition(b"end_header")[0]
        return _found(path, _PLY_TEXTURES.findall(head.decode("utf-8", "replace")))
    if suffix != ".obj":
        return {}
    reach = reach or Reach.of(path)
    files = material_libraries(path)
    for library in list(files.values()):
        if reach.reads(library):
            maps = [without_options(line) for line in _MTL_MAPS.findall(read_text(library))]
            files |= _found(library, maps)
    return files


def material_libraries(path: Path) -> dict[str, Path]:
    """Return the material libraries of an OBJ by the names in it, in order."""
    names: list[str] = []
    for line in _MTL_LIBRARIES.findall(read_text(path)):
        # names may hold spaces, and spaces are between names
        names += [line] if beside(path, line).is_file() else _LIBRARY_NAMES.findall(line) or [line]
    return _found(path, names)


def gltf_text(path: Path) -> str:
    """Return the JSON of a glTF or GLB file, as it is."""
    with path.open("rb") as stream:
        head = stream.read(20)
        if head[:4] != b"glTF":
            return read_text(path)
        length = min(int.from_bytes(head[12:16], "little"), path.stat().st_size)
        return stream.read(length).decode("utf-8", "replace")


def gltf_binary(path: Path) -> bytes:
    """Return the bytes that follow the JSON of a GLB file, less the 8 of their own header."""
    with path.open("rb") as stream:
        head = stream.read(20)
        stream.seek(20 + int.from_bytes(head[12:16], "little") + 8)
        return stream.read()


def read_text(path: Path) -> str:
    """Read a text file, whatever its encoding."""
    return path.read_text(encoding="utf-8", errors="replace")


def without_options(line: str) -> str:
    """Return the file name of an MTL map: options (``-s 1 1 1``) come before it."""
    return line.split()[-1] if line.startswith("-") else line


def beside(holder: Path, name: str) -> Path:
    """Resolve a name, from the folder of the file that holds it."""
    plain = unquote(name.strip().strip('"').removeprefix("file://")).replace("\\", "/")
    return holder.parent / plain


def _found(holder: Path, names: list[str]) -> dict[str, Path]:
    """Resolve names."""
    return {name: beside(holder, name) for name in names}
