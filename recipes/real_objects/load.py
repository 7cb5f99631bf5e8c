"""Turn entries of the table into partial splat objects.

Conventions
-----------
* Splats are in the file's own frame and units, like any user's file; only scans are levelled on
  their table (z up, x to the sensor's right, metres).
* Everything is a function of the entry: fixed sampling seed, fixed cut.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gscomplete.errors import UserError
from gscomplete.splats import Splats, transform_splats
from gscomplete.splats.formats.compressed_ply import read_compressed_ply
from gscomplete.views import ObjectFrame, UpAxis
from recipes.real_objects.catalogue import ENTRIES, Entry
from splatcomplete_data.cuts.geometry import PartialCut
from splatcomplete_data.mesh.files.load import BakedLight, GltfColors, load_mesh, mesh_to_discs
from splatcomplete_data.points import points_to_splats
from splatcomplete_data.scan import PointCloud
from splatcomplete_data.scan.read import read_scan

SPLATS_PER_MESH = 30_000
"""Discs that cover a complete mesh; the paper's parts have 20k to 100k."""


@dataclass(frozen=True, slots=True)
class RealObject:
    """A partial object as a user would bring it."""

    name: str
    prompt: str
    up: UpAxis
    """File axis that points up."""
    partial: Splats
    complete: Splats | None
    """The complete object, where it is known."""
    note: str
    """How the part came about."""
    captured: bool = False
    """Whether it was trained from photos and nothing was cut off it."""

    @property
    def true_frame(self) -> ObjectFrame | None:
        """Object frame of the complete object, where it is known."""
        return None if self.complete is None else ObjectFrame.about(self.complete, self.up)


def names() -> list[str]:
    """Return the names of all objects in the table's order."""
    return [entry.name for entry in ENTRIES]


def find(name: str) -> Entry:
    """Return an entry by its name.

    Raises:
        UserError: there is none.
    """
    for entry in ENTRIES:
        if entry.name == name:
            return entry
    raise UserError(f"real object: expected one of {', '.join(names())}; found {name!r}")


def load_real_object(name: str, data_dir: Path) -> RealObject:
    """Make one partial object.

    Args:
        name: an entry's name.
        data_dir: the folder with MANIFEST.tsv.

    Raises:
        UserError: the name is unknown, a file is missing or broken, or the cut keeps nothing.
    """
    return load_entry(find(name), data_dir)


def load_entry(entry: Entry, data_dir: Path) -> RealObject:
    """Make the partial object of an entry, which need not be in the table; raises as above."""
    name, path = entry.name, data_dir / entry.path
    if not path.is_file():
        raise UserError(f"{path}: real object {name}: no such file")
    prompt = entry.prompt or manifest_captions(data_dir)[entry.path]
    if entry.source == "scan":
        splats = _scanned_object(path, entry)
        return RealObject(name, prompt, entry.up, splats, None, "one Kinect view")
    complete = (
        read_compressed_ply(path) if entry.source == "splats" else _covered_mesh(data_dir, entry)
    )
    cut = cut_object(complete, entry)
    if cut.kept == 0:
        raise UserError(f"{path}: real object {name}: the cut keeps nothing")
    return RealObject(name, prompt, entry.up, complete.select(cut.mask), complete, cut.reason)


def manifest_captions(data_dir: Path) -> dict[str, str]:
    """Return the captions of MANIFEST.tsv by path.

    Raises:
        UserError: there is no manifest.
    """
    path = data_dir / "MANIFEST.tsv"
    if not path.is_file():
        raise UserError(f"{path}: expected the data folder's manifest, found no file")
    with path.open(encoding="utf-8", newline="") as file:
        rows = csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE)
        return {row["path"]: row["caption"].split(" (")[0] for row in rows}


def cut_object(complete: Splats, entry: Entry) -> PartialCut:
    """Apply an entry's cut in the object frame; the mask fits the splats as given.

    Raises:
        UserError: the entry has no cut.
    """
    if entry.cut is None:
        raise UserError(f"real object {entry.name}: expected a cut, found none")
    frame = ObjectFrame.about(complete, entry.up)
    level = transform_splats(complete, frame.object_from_file)
    return entry.cut.apply(level)


def _covered_mesh(data_dir: Path, entry: Entry) -> Splats:
    """Cover a mesh with discs, softly lit from above."""
    texture = None if entry.texture is None else data_dir / entry.texture
    colors: GltfColors = "linear" if entry.has_linear_colors else "srgb"
    mesh = load_mesh(
        data_dir / entry.path, texture=texture, gltf_colors=colors, allow_outside=data_dir
    )
    light = BakedLight.from_above(entry.up) if entry.is_shaded else None
    return mesh_to_discs(mesh, SPLATS_PER_MESH, light=light)


def _scanned_object(path: Path, entry: Entry) -> Splats:
    """Cut one labelled object from a table-top scan and level it on the table."""
    cloud = read_scan(path).cloud
    if cloud.labels is None:
        raise UserError(f"{path}: real object {entry.name}: expected a label field, found none")
    table = cloud.select(np.flatnonzero(cloud.labels // 10 == 0))
    rotation = rotation_from_table_points(table.points)
    chosen: PointCloud = cloud.select(np.flatnonzero(cloud.labels // 10 == entry.label))
    if len(chosen) == 0:
        raise UserError(f"{path}: real object {entry.name}: no point has label {entry.label}x")
    return points_to_splats(chosen.points @ rotation.T, chosen.colors)


def rotation_from_table_points(
    table: NDArray[np.floating],  # [N, 3]
) -> NDArray[np.floating]:  # [3, 3]
    """Return the rotation that makes a table horizontal: z away from it, x to the right.

    The table is the plane through the middle of its points (outliers dropped twice); up is the
    side of the sensor, which stands at the origin looking along +z with x to its right.
    """
    points = table
    for _ in range(3):
        center = points.mean(axis=0)
        normal = np.linalg.eigh(np.cov((points - center).T))[1][:, 0]
        distance = np.abs((points - center) @ normal)
        points = points[distance <= 2.5 * np.median(distance)]
    up = normal if normal @ center < 0 else -normal
    right = np.array([1.0, 0.0, 0.0]) - up[0] * up
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(up, right), up])
