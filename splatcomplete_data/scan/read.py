"""Read scans of every kind: PLY, PCD, XYZ text, LAS/LAZ, and meshes of scanned rooms.

Conventions
-----------
* Points are in the file's frame and units, float64 (LAS scales and offsets applied); rows with a
  coordinate that is not finite are dropped and counted.
* Colours become sRGB in [0, 1] (``cloud.unit_colors``; LAS files that hold bytes in 16-bit fields
  are noticed). A cloud without colour is grey.
* A mesh becomes points spread evenly over its surface.
"""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gscomplete.errors import UserError, naming
from gscomplete.splats.ply_files.header import Element, PlyError, PlyHeader, read_header
from gscomplete.splats.ply_files.payload import parse_records, read_payload
from gscomplete.views import UpAxis
from splatcomplete_data.mesh.files.up_axis import UP_SAYING_SUFFIXES, up_of_mesh_file
from splatcomplete_data.scan.cloud import NO_COLOR, PointCloud, grey_colors, unit_colors
from splatcomplete_data.scan.pcd import Position, read_pcd
from splatcomplete_data.scan.text import read_text_scan

MESH_SUFFIXES = (".obj", ".glb", ".gltf", ".stl", ".dae", ".off")
TEXT_SUFFIXES = (".xyz", ".xyzrgb", ".txt", ".pts", ".asc", ".csv")
MESH_POINTS = 500_000
"""Points that a scan mesh is sampled with."""


@dataclass(frozen=True, slots=True)
class Scan:
    """A scan as read."""

    cloud: PointCloud
    rows: int
    """Points in the file, before those that are not finite were dropped."""
    notes: tuple[str, ...] = ()
    viewpoint: Position | None = None
    """Where the scanner stood, in the file's frame; None = the file does not say."""
    up: UpAxis | None = None
    """Axis that is up according to the file; None = the file does not say."""


def read_scan(path: Path) -> Scan:
    """Read a scan, by the file's suffix.

    Raises:
        UserError: the file is missing, empty, of no known kind, or holds no finite point.
    """
    if not path.is_file():
        kind = "a folder" if path.is_dir() else "none"
        raise UserError(f"{path}: expected a scan file, found {kind}")
    if path.stat().st_size == 0:
        raise UserError(f"{path}: expected a scan file, found an empty file")
    suffix = path.suffix.lower()
    if suffix == ".pcd":
        found = read_pcd(path)
        scan = _checked(found.cloud, () if found.is_colored else (NO_COLOR,))
        scan = dataclasses.replace(scan, viewpoint=found.viewpoint, up=found.up)
    elif suffix == ".ply":
        scan = _read_ply(path)
    elif suffix in (".las", ".laz"):
        scan = _read_las(path)
    elif suffix in TEXT_SUFFIXES:
        scan = _checked(*read_text_scan(path))
    elif suffix in MESH_SUFFIXES:
        scan = _read_mesh(path)
        if suffix in UP_SAYING_SUFFIXES:
            scan = dataclasses.replace(scan, up=up_of_mesh_file(path))
    else:
        known = ", ".join((".ply", ".pcd", ".las", ".laz", *TEXT_SUFFIXES, *MESH_SUFFIXES))
        raise UserError(f"{path}: expected a scan ({known}), found suffix {suffix!r}")
    if len(scan.cloud) == 0:
        raise UserError(f"{path}: expected points with finite coordinates, found none")
    return scan


def _checked(cloud: PointCloud, notes: tuple[str, ...]) -> Scan:
    """Drop points that are not finite."""
    finite = np.isfinite(cloud.points).all(axis=1)
    kept = cloud if finite.all() else cloud.select(np.flatnonzero(finite))
    return Scan(kept, len(cloud), notes)


def _read_ply(path: Path) -> Scan:
    """Read the vertices of a PLY; with faces, the surface (its vertices may be far apart)."""
    try:
        header = read_header(path)
        vertex = header.find("vertex")
        if vertex is None:
            raise PlyError(path, "bad_header", "expected an element 'vertex', found none")
        if "rot_0" in vertex.names or "packed_position" in vertex.names:
            raise UserError(f"{path}: expected a point cloud, found Gaussian splats (use: crop)")
        faces = header.find("face")
        if faces is not None and faces.count > 0:
            return _read_mesh(path)
        return _ply_points(path, header, vertex)
    except (ValueError, MemoryError, OverflowError) as error:
        raise UserError(f"{path}: cannot read it as a point cloud ({error})") from error


def _ply_points(path: Path, header: PlyHeader, vertex: Element) -> Scan:
    """Read points and colours of a PLY's vertices."""
    if vertex.has_lists:
        raise UserError(f"{path}: element vertex: expected plain numbers, found lists")
    records = parse_records(path, header, vertex, read_payload(path, header, vertex))
    places = {name: f"p{i}" for i, name in enumerate(vertex.names)}
    if not {"x", "y", "z"} <= set(places):
        found = ", ".join(vertex.names)
        raise UserError(f"{path}: element vertex: expected x, y, z; found {found}")
    with np.errstate(invalid="ignore"):  # signalling NaNs
        points = np.stack([records[places[axis]].astype(np.float64) for axis in "xyz"], axis=1)
    for prefix in ("", "diffuse_"):
        channels = [places.get(prefix + name) for name in ("red", "green", "blue")]
        if None not in channels:
            values = [records[channel] for channel in channels if channel is not None]
            colors = unit_colors(np.stack(values, axis=1))
            return _checked(PointCloud(points, colors), ())
    return _checked(PointCloud(points, grey_colors(len(points))), (NO_COLOR,))


def _read_las(path: Path) -> Scan:
    """Read LAS or LAZ by way of laspy."""
    from gscomplete.util.optional import import_optional

    laspy = import_optional("laspy", "reading LAS and LAZ files")
    _check_las_header(path)
    try:
        las = laspy.read(str(path))
        points = np.stack([np.asarray(las.x), np.asarray(las.y), np.asarray(las.z)], axis=1)
        names = set(las.point_format.dimension_names)
        channels = None
        if {"red", "green", "blue"} <= names:
            channels = np.stack([np.asarray(las[name]) for name in ("red", "green", "blue")], 1)
    except Exception as error:  # laspy and its decoders raise errors of many kinds
        raise UserError(f"{path}: cannot read it as LAS or LAZ ({error})") from error
    if channels is None or not channels.any():
        cloud = PointCloud(points.astype(np.float64), grey_colors(len(points)))
        return _checked(cloud, (NO_COLOR,))
    notes: tuple[str, ...] = ()
    if channels.max() <= 255:
        channels, notes = channels.astype(np.uint8), ("colours are bytes in 16-bit fields",)
    return _checked(PointCloud(points.astype(np.float64), unit_colors(channels)), notes)


def _check_las_header(path: Path) -> None:
    """Refuse counts that the file's size contradicts, before laspy allocates memory for them.

    Raises:
        UserError: it is no LAS file, or shorter than its header says.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(375)
    if head[:4] != b"LASF" or len(head) < 227:
        raise UserError(f"{path}: cannot read it as LAS or LAZ (no LASF header)")

    def field(offset: int, length: int) -> int:
        return int.from_bytes(head[offset : offset + length], "little")

    is_new = field(25, 1) >= 4 and len(head) >= 255  # LAS 1.4 has 64-bit counts
    points = max(field(107, 4), field(247, 8) if is_new else 0)
    packed = bool(field(104, 1) & 0x80)
    room = 50 * size if packed else (size - field(96, 4)) // max(field(105, 2), 1)
    if points > room:
        raise UserError(f"{path}: truncated: expected {points:,} points, room for {max(room, 0):,}")
    if packed and points:
        _check_chunks(path, field(96, 4), size)
    records = field(100, 4) + (field(243, 4) if is_new else 0)
    if 54 * records > size:
        raise UserError(
            f"{path}: expected {records:,} header records, found a file of {size} bytes"
        )


def _check_chunks(path: Path, start: int, size: int) -> None:
    """Refuse a LAZ file whose table of chunks is larger than the file: its decoder would abort.

    Raises:
        UserError: it is.
    """
    with path.open("rb") as stream:
        stream.seek(start)
        table = int.from_bytes(stream.read(8), "little", signed=True)
        if table == -1:  # written as a stream: the table's place is told at the end
            stream.seek(-8, os.SEEK_END)
            table = int.from_bytes(stream.read(8), "little", signed=True)
        if not start <= table <= size - 8:
            raise UserError(f"{path}: table of chunks: expected within the file, found at {table}")
        stream.seek(table + 4)
        chunks = int.from_bytes(stream.read(4), "little")
    if chunks > size:
        raise UserError(
            f"{path}: table of chunks: expected at most {size:,} in a file of that many bytes, "
            f"found {chunks:,}"
        )


def _read_mesh(path: Path) -> Scan:
    """Sample a scan mesh evenly."""
    from splatcomplete_data.mesh.convert import convert_mesh
    from splatcomplete_data.mesh.files.load import load_mesh

    mesh = load_mesh(path)
    with naming(path):
        made = convert_mesh(mesh, MESH_POINTS)
    points = made.splats.means.numpy().astype(np.float64) + np.array(mesh.offset or 0.0)
    colors = made.splats.base_colors.numpy().clip(0, 1).astype(np.float32)
    note = f"a mesh of {mesh.triangles:,} triangles, sampled at a spacing of {made.spacing:.4g}"
    return _checked(PointCloud(points, colors), (*mesh.notes, note))
