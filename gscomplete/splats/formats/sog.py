"""PlayCanvas's SOG, version 2: splats as lossless WebP pictures and a ``meta.json``.

Conventions
-----------
* A file ``.sog`` is a zip of them; a folder holds them beside its ``meta.json``. Every pixel is a
  splat, row by row from the top left; pixels beyond ``count`` mean nothing.
* Positions: sign(x) ln(|x| + 1) in 16 bits between ``mins`` and ``maxs``, in two pictures.
  Log scales and f_dc: one byte each into a codebook of 256. Opacity: a byte, linear.
* Quaternions: the three smaller components over +/- sqrt(1/2); alpha 252 + i says that component i
  of (w, x, y, z) was the largest.
* Harmonics: 16 bits into a palette of rows, whose values are bytes into a codebook; 64 rows of the
  palette lie side by side.
* The frame is that of a PLY. Written splats are in Morton order, which packs better.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from gscomplete.errors import UserError
from gscomplete.splats.formats.palette import CODES, codebook, row_palette
from gscomplete.splats.ply_files.records import LOG_SCALE_LIMIT
from gscomplete.splats.record import SH_C0, Splats
from gscomplete.splats.thinning import space_filling_order
from gscomplete.util.arrays import Float64Array
from gscomplete.util.atomic import atomic_path
from gscomplete.util.limits import check_decoded_bytes, most_decoded_bytes

META_FILE = "meta.json"
_VERSION = 2
_COEFFICIENTS = {1: 3, 2: 8, 3: 15}
_PALETTE_WIDTH = 64
"""Rows of the palette side by side."""
_MOST_ROWS = 8192
"""Rows of the palette of splats that are more than fit one each."""
_MOST_LABELS = 65536
_FIRST_TAG = 252
_MOST_SIDE = 16383
_PLACES = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Components that are stored, by the largest."""

Pixels = NDArray[np.uint8]
_DAMAGES = (
    *(OSError, zipfile.BadZipFile, Image.DecompressionBombError, SyntaxError, NotImplementedError),
    *(ValueError, OverflowError, KeyError, TypeError, IndexError),
)
"""What a damaged file raises."""


def read_sog(path: Path) -> Splats:
    """Read a .sog file, a folder with a meta.json, or that meta.json.

    Raises:
        UserError: it is no SOG of version 2, or damaged.
    """
    try:
        if path.suffix.lower() != ".sog":
            folder = path if path.is_dir() else path.parent
            return _read(_Source(folder / META_FILE, None))
        with zipfile.ZipFile(path) as archive:
            return _read(_Source(path, archive))
    except _DAMAGES as error:
        raise UserError(f"{path}: cannot read it as SOG ({error})") from error


@dataclass(frozen=True, slots=True)
class _Source:
    """Where the members are: a zip, or the folder of a ``meta.json``."""

    path: Path
    archive: zipfile.ZipFile | None

    def member(self, name: str) -> bytes:
        """Return the bytes of a member.

        Raises:
            UserError: its name leads elsewhere, or it unpacks to too much.
        """
        if not isinstance(name, str) or name != Path(name).name:
            raise UserError(f"{self.path}: expected names of files beside it, found {name!r}")
        if self.archive is None:
            return (self.path.parent / name).read_bytes()
        check_decoded_bytes(self.path, self.archive.getinfo(name).file_size, name)
        return self.archive.read(name)

    def picture(self, name: str, least: int) -> Pixels:  # [pixels, 4]
        """Return a picture's pixels, of which there must be at least so many."""
        data = self.member(name)
        with Image.open(io.BytesIO(data)) as image:
            width, height = image.size
            if width * height < least:
                raise UserError(
                    f"{self.path}: {name}: expected {least:,} pixels, found {width} x {height}"
                )
            if 4 * width * height > most_decoded_bytes(self.path):
                raise UserError(f"{self.path}: {name}: {width} x {height} pixels are too many")
            return np.asarray(image.convert("RGBA")).reshape(-1, 4)

    def single(self, entry: dict[str, Any], least: int) -> Pixels:
        """Return the picture of an entry that has one."""
        (name,) = entry["files"]
        return self.picture(name, least)

    def pair(self, entry: dict[str, Any], least: int) -> tuple[Pixels, Pixels]:
        """Return the pictures of an entry that has two."""
        first, second = entry["files"]
        return self.picture(first, least), self.picture(second, least)


def _read(source: _Source) -> Splats:
    """Read all members."""
    meta = json.loads(source.member(META_FILE))
    found = meta.get("version") if isinstance(meta, dict) else None
    if found != _VERSION:
        raise UserError(f"{source.path}: expected SOG version {_VERSION}, found {found!r}")
    count = meta["count"]
    if not isinstance(count, int) or not 0 < count <= _MOST_SIDE**2:
        raise UserError(f"{source.path}: count: expected a number of splats, found {count!r}")
    low, high = source.pair(meta["means"], count)
    share = (low[:count, :3] + 256.0 * high[:count, :3]) / 65535
    ends = np.array([meta["means"][name] for name in ("mins", "maxs")], np.float64).reshape(2, 3)
    logs = ends[0] + share * (ends[1] - ends[0])
    scales = source.single(meta["scales"], count)[:count, :3]
    colors = source.single(meta["sh0"], count)[:count]
    base = _codes(meta["sh0"])[colors[:, :3]]
    quats = source.single(meta["quats"], count)[:count]
    sh = np.concatenate([base[:, None], _read_harmonics(source, meta, count)], axis=1)
    arrays = (
        np.sign(logs) * np.expm1(np.abs(logs)),
        _unpack(quats),
        np.exp(_codes(meta["scales"])[scales]),
        colors[:, 3] / 255,
        sh,
    )
    return Splats(*(torch.from_numpy(array.astype(np.float32)) for array in arrays))


def _codes(entry: dict[str, Any]) -> Float64Array:  # [CODES]
    """Return a codebook, filled up to what a byte can name."""
    codes = np.array(entry["codebook"], np.float64).reshape(-1)
    if not 0 < len(codes) <= CODES:
        raise ValueError(f"codebook: expected 1 to {CODES} values, found {len(codes)}")
    return np.pad(codes, (0, CODES - len(codes)), mode="edge")


def _read_harmonics(
    source: _Source, meta: dict[str, Any], count: int
) -> Float64Array:  # [N, K - 1, 3]
    """Return the coefficients above the base band; splats without a row of the palette have 0."""
    entry = meta.get("shN")
    if not entry:
        return np.zeros((count, 0, 3))
    bands, rows = entry["bands"], int(entry["count"])
    wide = _COEFFICIENTS[bands]
    centroids, labels = source.pair(entry, 0)
    per_line = _PALETTE_WIDTH * wide
    if len(labels) < count or len(centroids) % per_line:
        raise UserError(f"{source.path}: shN: the pictures do not fit {count:,} splats")
    index = labels[:count, 0] + 256 * labels[:count, 1].astype(np.int64)
    palette = _codes(entry)[centroids[:, :3]].reshape(-1, wide, 3)
    known = index < min(rows, len(palette))
    return np.where(known[:, None, None], palette[np.where(known, index, 0)], 0.0)


def _unpack(pixels: Pixels) -> Float64Array:  # [N, 4] -> [N, 4] wxyz
    """Return unit quaternions; those without a tag are no rotation."""
    largest = pixels[:, 3].astype(np.int64) - _FIRST_TAG
    valid = largest >= 0
    small = (pixels[:, :3] / 255.0 * 2 - 1) / math.sqrt(2)
    result = np.zeros((len(pixels), 4))
    np.put_along_axis(result, _PLACES[np.where(valid, largest, 0)], small, axis=1)
    rest = np.sqrt(np.maximum(0.0, 1 - np.square(small).sum(axis=1)))
    np.put_along_axis(result, np.where(valid, largest, 0)[:, None], rest[:, None], axis=1)
    result /= np.maximum(np.linalg.norm(result, axis=1, keepdims=True), 1e-12)
    return np.where(valid[:, None], result, [[1.0, 0.0, 0.0, 0.0]])


def write_sog(path: Path, splats: Splats) -> tuple[str, ...]:
    """Write splats as a .sog file; return what is lost.

    Args:
        path: destination, replaced atomically.
        splats: finite splats in the frame of a PLY.

    Raises:
        UserError: there are no splats, too many, or the file cannot be written.
    """
    side = _picture_side(len(splats))
    if not 0 < side <= _MOST_SIDE:
        raise UserError(f"{path}: SOG: expected 1 to 268 million splats, found {len(splats):,}")
    splats = splats.select(space_filling_order(splats.means.numpy()))
    means = splats.means.double().numpy()
    logs = np.sign(means) * np.log1p(np.abs(means))
    low, high = logs.min(axis=0), logs.max(axis=0)
    steps = np.rint((logs - low) / np.where(high > low, high - low, 1.0) * 65535).astype(np.int64)
    floor = math.exp(LOG_SCALE_LIMIT)
    scale_codes, scales = codebook(splats.scales.clamp_min(floor).log().numpy())
    color_codes, colors = codebook(((splats.base_colors - 0.5) / SH_C0).numpy())
    opacities = np.rint(splats.opacities.clamp(0, 1).numpy() * 255).astype(np.uint8)
    pictures = {
        "means_l.webp": _opaque(steps & 255),
        "means_u.webp": _opaque(steps >> 8),
        "quats.webp": _pack(splats.quaternions.double().numpy()),
        "scales.webp": _opaque(scales),
        "sh0.webp": np.concatenate([colors, opacities[:, None]], axis=1),
    }
    meta: dict[str, Any] = {
        "version": _VERSION,
        "asset": {"generator": "splatcomplete-data"},
        "count": len(splats),
        "means": {
            "mins": low.tolist(),
            "maxs": high.tolist(),
            "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": {"codebook": scale_codes.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": color_codes.tolist(), "files": ["sh0.webp"]},
    }
    data = {name: _webp(pixels, side) for name, pixels in pictures.items()}
    if splats.sh_degree:
        meta["shN"], more = _harmonics(splats, side)
        data |= more
    data[META_FILE] = json.dumps(meta, separators=(",", ":")).encode()
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, content in data.items():  # one date: the same splats give the same bytes
            archive.writestr(zipfile.ZipInfo(name), content)
    return ("values are quantised", "the order of splats")


def _harmonics(splats: Splats, side: int) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Return the entry and the pictures of the coefficients above the base band."""
    wide = splats.sh.shape[1] - 1
    rows = splats.sh[:, 1:].reshape(len(splats), -1).float()
    fit = len(rows) <= _MOST_LABELS
    palette, labels = row_palette(rows, _MOST_LABELS if fit else _MOST_ROWS)
    codes, indices = codebook(palette.numpy())
    lines = -(-len(palette) // _PALETTE_WIDTH)
    centroids = np.zeros((lines * _PALETTE_WIDTH * wide, 4), np.uint8)
    centroids[:, 3] = 255
    centroids[: len(palette) * wide, :3] = indices.reshape(-1, 3)
    index = labels.numpy()
    split = np.stack([index & 255, index >> 8, np.zeros_like(index)], axis=1)
    files = ["shN_centroids.webp", "shN_labels.webp"]
    entry = {
        "count": len(palette),
        "bands": splats.sh_degree,
        "codebook": codes.tolist(),
        "files": files,
    }
    pictures = (_webp(centroids, _PALETTE_WIDTH * wide), _webp(_opaque(split), side))
    return entry, dict(zip(files, pictures, strict=True))


def _picture_side(count: int) -> int:
    """Return the width of pictures that hold so many pixels: about square, in steps of 4."""
    return 4 * math.ceil(math.sqrt(count) / 4)


def _opaque(values: NDArray[np.integer]) -> Pixels:  # [N, 3] -> [N, 4]
    """Return pixels without transparency."""
    return np.pad(values.astype(np.uint8), ((0, 0), (0, 1)), constant_values=255)


def _webp(pixels: Pixels, width: int) -> bytes:  # [N, 4]
    """Return a lossless picture, filled up to whole rows."""
    height = -(-len(pixels) // width)
    filled = np.zeros((height * width, 4), np.uint8)
    filled[: len(pixels)] = pixels
    out = io.BytesIO()
    picture = Image.fromarray(filled.reshape(height, width, 4), "RGBA")
    picture.save(out, format="WEBP", lossless=True, exact=True)
    return out.getvalue()


def _pack(quaternions: Float64Array) -> Pixels:  # [N, 4] wxyz -> [N, 4]
    """Return the three smaller components as bytes, and which one is left out."""
    unit = quaternions / np.maximum(np.linalg.norm(quaternions, axis=1, keepdims=True), 1e-12)
    largest = np.abs(unit).argmax(axis=1)
    sign = np.where(np.take_along_axis(unit, largest[:, None], axis=1) < 0, -1.0, 1.0)
    small = np.take_along_axis(unit * sign, _PLACES[largest], axis=1)
    bytes_ = np.rint((small * math.sqrt(2) * 0.5 + 0.5).clip(0, 1) * 255)
    return np.concatenate([bytes_, _FIRST_TAG + largest[:, None]], axis=1).astype(np.uint8)
