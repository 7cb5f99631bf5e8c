"""Import and export of splat files other than PLY: .splat, .spz, .glb, SuperSplat's compressed PLY.

Conventions
-----------
* PLY is the native form; everything else is converted at the border and is lossy: ``.splat`` has
  8-bit colours and rotations and no harmonics, ``.spz`` and compressed PLY are quantised. Only
  ``.glb`` (``glb_splats``) holds all that a PLY's splats have.
* ``.splat``: 32 bytes per splat: position and linear scales as float32, sRGB and opacity as bytes,
  quaternion (w, x, y, z) as bytes (value x 128 + 128).
* ``.spz`` stores right-up-back axes, PLY files of the same object right-down-front: reading and
  writing turn by 180 degrees about x, harmonics too, and say so in ``notes``. So it is with
  ``.glb``, whose y axis points up, but about z, as PlayCanvas's splat-transform does.
* SPZ and writing of compressed PLY go through the package gsply.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.splats import (
    SH_C0,
    PlyError,
    Similarity,
    Splats,
    colors_to_sh,
    read_compressed_ply,
    read_splats,
    transform_splats,
    usable_rows,
    write_splats,
)
from gscomplete.splats.ply import SplatFile, splat_element
from gscomplete.splats.ply_files.header import Element
from gscomplete.splats.ply_files.layout import find_layout
from gscomplete.splats.ply_files.records import LOG_SCALE_LIMIT, LOGIT_LIMIT
from gscomplete.util.atomic import atomic_path
from splatcomplete_data.glb_splats import read_glb_splats, write_glb_splats
from splatcomplete_data.optional import import_optional
from splatcomplete_data.spz_size import check_spz_size

SplatFormat = Literal["ply", "compressed.ply", "splat", "spz", "glb"]
"""Formats that are written; all are read."""
SpzVersion = Literal[3, 4]
"""3: gzip, read everywhere; 4: zstandard, smaller."""
_SUFFIXES: tuple[SplatFormat, ...] = ("compressed.ply", "ply", "splat", "spz", "glb")

_SPLAT_ROW = np.dtype([("xyz", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rot", "u1", 4)])
_NORMALS = ("nx", "ny", "nz")
_COMMENTS_SHOWN = 5
_GLB_TURN = Similarity(1.0, torch.diag(torch.tensor([-1.0, -1.0, 1.0])), torch.zeros(3))
_HALF_TURN = Similarity(1.0, torch.diag(torch.tensor([1.0, -1.0, -1.0])), torch.zeros(3))


@dataclass(frozen=True, slots=True, eq=False)
class Imported:
    """Splats of any file, as a PLY of the same object would have them."""

    splats: Splats
    format: SplatFormat
    notes: tuple[str, ...] = ()
    file_from_source: Similarity | None = None
    """What took the file's axes to those of a PLY; None = they are the same."""
    left: tuple[str, ...] = ()
    """What a plain PLY holds beside its splats: no converted file has it."""


def format_of(path: Path) -> SplatFormat:
    """Return the format that a file's name says.

    Raises:
        UserError: it says none of them.
    """
    name = path.name.lower()
    for kind in _SUFFIXES:
        if name.endswith("." + kind):
            return kind
    raise UserError(
        f"{path}: expected .ply, .compressed.ply, .splat, .spz or .glb, found {path.name!r}"
    )


def read_any_splats(path: Path) -> Imported:
    """Read a splat file of any format.

    Raises:
        UserError: it is missing, of another kind, or damaged.
    """
    kind = format_of(path)
    if not path.is_file():
        raise UserError(f"{path}: expected a splat file, found none")
    if kind == "splat":
        return Imported(_read_dot_splat(path), kind)
    if kind == "spz":
        note = "SPZ axes (right, up, back) turned by 180 degrees about x to PLY's"
        return Imported(_read_spz(path), kind, (note,), _HALF_TURN)
    if kind == "glb":
        raw, others = read_glb_splats(path)
        note = "glTF axes (y up) turned by 180 degrees about z to PLY's"
        left = (f"{others} primitives without splats",) if others else ()
        return Imported(transform_splats(raw, _GLB_TURN), kind, (note,), _GLB_TURN, left)
    try:
        if kind == "ply":
            file = read_splats(path)
            return Imported(file.splats, kind, file.warnings, left=_beside_splats(file))
    except PlyError as error:
        if error.finding != "compressed_splat_file":
            raise
    return Imported(read_compressed_ply(path), "compressed.ply")


def write_any_splats(path: Path, splats: Splats, *, spz_version: SpzVersion = 3) -> tuple[str, ...]:
    """Write splats in the format of the name; return what is lost.

    Args:
        path: destination, replaced atomically.
        splats: activated splats in the frame of a PLY.
        spz_version: version of SPZ files.

    Raises:
        UserError: the name says no format, a splat is not finite, or the file cannot be written.
    """
    kind = format_of(path)
    usable, reasons = usable_rows(splats)
    if not bool(usable.all()):
        raise UserError(f"{path}: expected finite splats, found {dict(reasons)}")
    if kind == "ply":
        write_splats(path, splats)
        return ()
    if kind == "glb":
        write_glb_splats(path, transform_splats(splats, _GLB_TURN))
        return ()
    if kind == "splat":
        _write_dot_splat(path, splats)
        lost = ("8-bit colours and rotations",)
        return (*lost, f"harmonics of degree {splats.sh_degree}") if splats.sh_degree else lost
    gsply = import_optional("gsply", f"writing {kind} files")
    moved = transform_splats(splats, _HALF_TURN) if kind == "spz" else splats
    with atomic_path(path) as temporary:
        data = _to_gsply(gsply, moved)
        if kind == "spz":
            gsply.write_spz(temporary, data, version=spz_version)
        else:
            temporary.write_bytes(gsply.compress_to_bytes(data))
    return ("values are quantised",)


def _beside_splats(file: SplatFile) -> tuple[str, ...]:
    """Name what a PLY file holds that is no splat value: properties, elements, comments."""
    element = splat_element(file.header, file.path)
    layout = find_layout(element, file.path)
    left = []
    unused = [name for name in layout.foreign if name not in _NORMALS]
    unused += _NORMALS if _has_normals(file, element) else ()
    if unused:
        left.append(f"properties {', '.join(unused)}")
    if layout.dropped_bands:
        left.append(f"harmonics above degree {file.splats.sh_degree}")
    others = [other.name for other in file.header.elements if other.name != element.name]
    if others:
        left.append(f"elements {', '.join(others)}")
    if file.comments:
        more = len(file.comments) - _COMMENTS_SHOWN
        shown = [repr(text) for text in file.comments[:_COMMENTS_SHOWN]]
        left.append(f"comments {', '.join(shown)}" + (f" and {more:,} more" if more > 0 else ""))
    return tuple(left)


def _has_normals(file: SplatFile, element: Element) -> bool:
    """Tell whether a file's normals say anything: most are zeros, and are written as such."""
    places = [element.names.index(name) for name in _NORMALS if name in element.names]
    if not places or element.count == 0:
        return False
    if file.header.format == "ascii":
        words = np.array(file.payload.records.tobytes().split(), np.float64)
        return bool(words.reshape(element.count, -1)[:, places].any())
    rows = file.payload.records.reshape(-1).view(element.row_dtype(file.header.byte_order))
    return any(bool(rows[f"p{place}"].any()) for place in places)


def _read_dot_splat(path: Path) -> Splats:
    """Read an antimatter15 .splat file."""
    size = path.stat().st_size
    if size == 0 or size % _SPLAT_ROW.itemsize:
        raise UserError(f"{path}: expected a multiple of 32 bytes, found {size}")
    rows = np.fromfile(path, _SPLAT_ROW)
    negative = int((rows["scale"] < 0).any(axis=1).sum())
    if negative:
        raise UserError(f"{path}: scale: expected no negative one, found {negative:,} splats with")
    quaternions = (rows["rot"].astype(np.float32) - 128.0) / 128.0
    length = np.linalg.norm(quaternions, axis=1, keepdims=True)
    quaternions = np.where(length > 0, quaternions / np.maximum(length, 1e-9), [[1, 0, 0, 0]])
    colors = rows["rgba"].astype(np.float32) / 255.0
    return Splats(
        torch.from_numpy(rows["xyz"].copy()),
        torch.from_numpy(quaternions.astype(np.float32)),
        torch.from_numpy(rows["scale"].copy()),
        torch.from_numpy(colors[:, 3].copy()),
        colors_to_sh(torch.from_numpy(colors[:, :3].copy())),
    )


def _write_dot_splat(path: Path, splats: Splats) -> None:
    """Write an antimatter15 .splat file."""
    rows = np.zeros(len(splats), _SPLAT_ROW)
    rows["xyz"] = splats.means.numpy()
    rows["scale"] = splats.scales.numpy()
    rgba = torch.cat([splats.base_colors, splats.opacities[:, None]], dim=1).clamp(0, 1) * 255
    rows["rgba"] = rgba.round().to(torch.uint8).numpy()
    turned = (splats.quaternions * 128 + 128).round().clamp(0, 255)
    rows["rot"] = turned.to(torch.uint8).numpy()
    with atomic_path(path) as temporary:
        rows.tofile(temporary)


def _read_spz(path: Path) -> Splats:
    """Read an SPZ file of version 1 to 4."""
    gsply = import_optional("gsply", "reading SPZ files")
    check_spz_size(path)
    try:
        data = gsply.read_spz(path)
        means = np.array(data.means, np.float32)
        higher = np.zeros((len(means), 0, 3)) if data.shN is None else np.asarray(data.shN)
        bands = max(k for k in (0, 3, 8, 15) if k <= higher.shape[1])
        sh = np.concatenate([np.asarray(data.sh0)[:, None], higher[:, :bands]], axis=1)
        raw = Splats(
            torch.from_numpy(means),
            torch.from_numpy(np.array(data.quats, np.float32)),
            torch.from_numpy(np.exp(np.array(data.scales, np.float32))),
            torch.from_numpy(1 / (1 + np.exp(-np.array(data.opacities, np.float32).reshape(-1)))),
            torch.from_numpy(sh.astype(np.float32)),
        )
    except Exception as error:  # damaged files raise whatever the decoder happens to raise
        raise UserError(f"{path}: cannot read it as SPZ ({error})") from error
    return transform_splats(raw, _HALF_TURN)


def _to_gsply(gsply: Any, splats: Splats) -> Any:
    """Turn splats into gsply's container of PLY values."""
    floor = math.exp(LOG_SCALE_LIMIT)
    opacities = splats.opacities.double()
    logits = torch.logit(opacities).clamp(-LOGIT_LIMIT, LOGIT_LIMIT)
    higher = None if splats.sh_degree == 0 else splats.sh[:, 1:].contiguous().numpy()
    return gsply.GSData(
        means=splats.means.numpy(),
        scales=splats.scales.clamp_min(floor).log().numpy(),
        quats=splats.quaternions.numpy(),
        opacities=logits.float().numpy(),
        sh0=((splats.base_colors - 0.5) / SH_C0).contiguous().numpy(),
        shN=higher,
    )
