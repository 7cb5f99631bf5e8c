"""Checks of mesh files for faults that trimesh does not report.

Conventions
-----------
* A file whose fault would give a wrong surface is refused; a fault that only loses colours gives a
  note.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from gscomplete.errors import UserError
from splatcomplete_data.mesh.files.side_files import gltf_text, side_files
from splatcomplete_data.mesh.files.textures import open_image
from splatcomplete_data.named_files import Reach

GLTF_SUFFIXES = (".gltf", ".glb")
MESH_SUFFIXES = (*GLTF_SUFFIXES, ".obj", ".ply", ".stl", ".dae", ".off")
_MAX_ZEROS = 2**24
"""Most elements of a glTF accessor without data, which stands for zeros: no mesh needs them."""
_PICTURE_SUFFIXES = (
    *(".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff", ".gif", ".tga", ".dds"),
    *(".exr", ".hdr", ".ktx", ".ktx2", ".jp2", ".ppm"),
)


def check_suffix(path: Path) -> None:
    """Refuse a file whose suffix is not a mesh format's; trimesh would open any archive.

    Raises:
        UserError: it is none.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise UserError(
            f"{path}: expected a mesh ({', '.join(MESH_SUFFIXES)}), found suffix {path.suffix!r}"
        )


def check_not_splats(path: Path) -> None:
    """Refuse a splat PLY where a mesh is expected.

    Raises:
        UserError: the file holds splats.
    """
    if path.suffix.lower() != ".ply":
        return
    with path.open("rb") as stream:
        head = stream.read(4096)
    if b"property float rot_0" in head or b"packed_position" in head:
        raise UserError(f"{path}: expected a mesh, found Gaussian splats (use: partial, crop)")


def refuse_unknown_geometry(path: Path) -> None:
    """Refuse glTF files whose surface trimesh would read wrongly.

    It reads Draco and meshopt geometry as zeros, and only the first of several instances.

    Raises:
        UserError: the file needs a decoder, or its instances written out.
    """
    if path.suffix.lower() not in GLTF_SUFFIXES:
        return
    _check_chunks(path)
    text = gltf_text(path)
    _check_zeros(path, text)
    for name in ("KHR_draco_mesh_compression", "EXT_meshopt_compression"):
        if name in text:
            raise UserError(
                f"{path}: geometry is compressed with {name}, expected plain buffers; decode it "
                "first: npx @gltf-transform/cli copy in.glb out.glb (Draco), or export without"
            )
    if "EXT_mesh_gpu_instancing" in text:
        raise UserError(
            f"{path}: instances are given by EXT_mesh_gpu_instancing, expected nodes of their own; "
            "write them out first: npx @gltf-transform/cli uninstance in.glb out.glb"
        )


def _check_chunks(path: Path) -> None:
    """Refuse a GLB whose chunks are longer than the file: memory is allocated for them first.

    Raises:
        UserError: one is.
    """
    size, place = path.stat().st_size, 12
    with path.open("rb") as stream:
        if stream.read(4) != b"glTF":
            return
        while place + 8 <= size:
            stream.seek(place)
            length = int.from_bytes(stream.read(4), "little")
            place += 8 + length
            if place > size:
                raise UserError(
                    f"{path}: truncated or damaged: expected a chunk up to byte {place:,}, found "
                    f"the end at {size:,}"
                )


def _check_zeros(path: Path, text: str) -> None:
    """Refuse large accessors without data, which stand for zeros.

    Raises:
        UserError: there is one.
    """
    try:
        accessors = json.loads(text).get("accessors", [])
        counts = [(i, a.get("count", 0), "bufferView" in a) for i, a in enumerate(accessors)]
    except (ValueError, AttributeError, TypeError, RecursionError):
        return  # what reads the file says what is wrong with it
    for index, count, has_data in counts:
        if not has_data and isinstance(count, int | float) and count > _MAX_ZEROS:
            raise UserError(
                f"{path}: accessors[{index}]: expected at most {_MAX_ZEROS:,} elements without a "
                f"bufferView, found {count:,}"
            )


def lost_files(path: Path, reach: Reach, *, with_pictures: bool) -> Iterator[str]:
    """Yield a note for every file that a mesh names and that is missing or not read.

    Args:
        path: the mesh file.
        reach: which files are read.
        with_pictures: whether its textures matter.
    """
    for name, file in side_files(path, reach).items():
        if not with_pictures and file.suffix.lower() in _PICTURE_SUFFIXES:
            continue
        refusal = reach.refusal(file)
        if refusal is not None:
            yield f"file {name} {refusal}; parts of the mesh lack it"
        elif not file.exists():
            yield f"file {name} is missing; parts of the mesh lack their texture or material"
        elif file.suffix.lower() in _PICTURE_SUFFIXES:
            try:
                open_image(file).close()
            except UserError as error:
                yield f"texture {name}: parts of the mesh lack it: {error}"
