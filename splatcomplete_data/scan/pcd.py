"""Scans in the Point Cloud Library's PCD format, organised or not.

Conventions
-----------
* Points keep the file's frame and units; points with a coordinate that is not finite are kept, too.
* ``rgb`` and ``rgba`` are one 32-bit word per point, 0xAARRGGBB, whatever scalar type the header
  gives it; or there are fields ``r``, ``g``, ``b``. Colours become sRGB in [0, 1]. A cloud without
  colour is grey, and ``is_colored`` says so.
* ``VIEWPOINT`` is the sensor's position, in the points' own frame (as PCL's normals take it), and
  its rotation. Its default, the origin without rotation, is also what writers put that do not know
  it. It is believed only for an organised cloud (HEIGHT above 1) whose columns follow x / z and
  rows y / z.
* Read: ASCII, binary, and ``binary_compressed`` (LZF, one field after the other).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gscomplete.errors import UserError
from gscomplete.util.arrays import Float32Array, Float64Array
from gscomplete.util.limits import check_decoded_bytes
from gscomplete.views import UpAxis
from splatcomplete_data.scan.cloud import PointCloud, grey_colors, unit_colors

Position = tuple[float, float, float]
_NO_VIEWPOINT = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
_PINHOLE = 0.99
"""Least correlation between rays and pixels for an organised cloud to be a picture taken from the
origin."""
_FEWEST_ORGANISED = 100
_TYPES = {"F": "f", "U": "u", "I": "i"}
_MAX_POINTS = 2**31
_MAX_COUNT = 65_536
"""Values of one field of a point; PCL's longest descriptors have 1,980."""


@dataclass(frozen=True, slots=True)
class _Header:
    """What a PCD header says."""

    names: tuple[str, ...]
    dtypes: tuple[np.dtype, ...]
    counts: tuple[int, ...]
    points: int
    data: str
    offset: int
    viewpoint: Position | None
    shape: tuple[int, int]

    def record(self) -> np.dtype:
        """Return the structured type of one point."""
        fields = zip(self.names, self.dtypes, self.counts, strict=True)
        unique = [(f"{i}:{name}", dtype, (count,)) for i, (name, dtype, count) in enumerate(fields)]
        return np.dtype(unique)


@dataclass(frozen=True, slots=True)
class PcdPoints:
    """What a PCD file holds."""

    cloud: PointCloud
    is_colored: bool
    viewpoint: Position | None = None
    """Position of the sensor; None = the file does not say."""
    up: UpAxis | None = None
    """Axis that is up in the picture of an organised cloud; None = unknown."""


def read_pcd(path: Path) -> PcdPoints:
    """Read a PCD file.

    Args:
        path: the file, ascii, binary or compressed.

    Returns:
        Its points, with colours and labels where it has them, file units.

    Raises:
        UserError: it is not a PCD file, lacks coordinates, or its data end early.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot read it ({error})") from error
    header = _parse_header(raw, path)
    columns = _columns(raw[header.offset :], header, path)
    missing = [axis for axis in "xyz" if axis not in columns]
    if missing:
        raise UserError(f"{path}: expected fields x, y, z; found {', '.join(columns)}")
    points = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=1)
    packed = columns.get("rgba", columns.get("rgb"))
    if packed is not None and packed.dtype.itemsize != 4:
        raise UserError(f"{path}: rgb: expected 4 bytes, found {packed.dtype.itemsize}")
    colors = None if packed is None else _unpack(packed)
    if colors is None and all(name in columns for name in "rgb"):
        colors = unit_colors(np.stack([columns[name] for name in "rgb"], axis=1))
    labels = columns["label"].astype(np.int64) if "label" in columns else None
    shown = grey_colors(len(points)) if colors is None else colors
    viewpoint, up = header.viewpoint, _up_of_picture(points, header.shape)
    if viewpoint is None and up is not None:
        viewpoint = (0.0, 0.0, 0.0)
    cloud = PointCloud(points, shown, labels)
    return PcdPoints(cloud, colors is not None, viewpoint, up if is_at_origin(viewpoint) else None)


def is_at_origin(viewpoint: Position | None) -> bool:
    """Tell whether a sensor is known to have stood at the origin."""
    return viewpoint == (0.0, 0.0, 0.0)


def _up_of_picture(
    points: Float64Array,  # [N, 3]
    shape: tuple[int, int],
) -> UpAxis | None:
    """Return the up axis of an organised cloud if it is a picture from the origin along z."""
    height, width = shape
    if height < 2 or width < 2 or height * width != len(points):
        return None
    known = np.flatnonzero(np.isfinite(points).all(axis=1) & (np.abs(points[:, 2]) > 0))
    if len(known) < _FEWEST_ORGANISED:
        return None
    x, y, z = points[known].T
    if not (np.all(z > 0) or np.all(z < 0)):
        return None
    rows, columns = np.divmod(known, width)
    across = np.corrcoef(x / z, columns)[0, 1]
    down = np.corrcoef(y / z, rows)[0, 1]
    if not (abs(across) > _PINHOLE and abs(down) > _PINHOLE):
        return None
    return "-Y" if (down > 0) == bool(z[0] > 0) else "Y"


def lzf_decompress(packed: bytes, size: int) -> bytes:
    """Expand LZF data to exactly ``size`` bytes.

    A control byte below 32 announces a run of literals; otherwise its top three bits are a length
    and the rest, with the next byte, a distance back into what has been written.

    Args:
        packed: the data.
        size: bytes they expand to.

    Returns:
        The bytes.

    Raises:
        ValueError: the data end early or expand to another size.
    """
    out = bytearray()
    position, end = 0, len(packed)
    try:
        while position < end and len(out) <= size:
            control = packed[position]
            position += 1
            if control < 32:
                out += packed[position : position + control + 1]
                position += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += packed[position]
                position += 1
            start = len(out) - ((control & 31) << 8) - packed[position] - 1
            position += 1
            _copy_back(out, start, length + 2)
    except IndexError as error:
        raise ValueError("lzf_decompress: the data end within a back reference") from error
    if len(out) != size:
        raise ValueError(f"lzf_decompress: expected {size} bytes, found {len(out)}")
    return bytes(out)


def _copy_back(out: bytearray, start: int, length: int) -> None:
    """Append ``length`` bytes from ``start`` on; the source may overlap what is being written."""
    if start < 0:
        raise ValueError("lzf_decompress: a back reference points before the beginning")
    period = len(out) - start
    if period >= length:
        out += out[start : start + length]
    else:
        out += (out[start:] * (length // period + 1))[:length]


def _parse_header(raw: bytes, path: Path) -> _Header:
    """Read the lines up to and including DATA."""
    entries: dict[str, list[str]] = {}
    offset = 0
    while "DATA" not in entries:
        end = raw.find(b"\n", offset, offset + 4096)
        if end < 0:
            raise UserError(f"{path}: expected a PCD header ending in a DATA line, found none")
        words = raw[offset:end].decode("ascii", "replace").split()
        offset = end + 1
        if words and not words[0].startswith("#"):
            entries[words[0]] = words[1:]
    try:
        names = tuple(entries["FIELDS"])
        sizes = [int(word) for word in entries["SIZE"]]
        kinds = [_TYPES[word] for word in entries["TYPE"]]
        counts = tuple(int(word) for word in entries.get("COUNT", ["1"] * len(names)))
        points = int(entries["POINTS"][0])
        shapes = zip(kinds, sizes, strict=True)
        dtypes = tuple(np.dtype(f"<{kind}{size}") for kind, size in shapes)
        data = entries["DATA"][0]
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise UserError(f"{path}: PCD header: missing or malformed entry ({error})") from error
    if not len(names) == len(dtypes) == len(counts) or not 0 <= points < _MAX_POINTS:
        raise UserError(f"{path}: PCD header: FIELDS, SIZE, TYPE, COUNT and POINTS do not agree")
    if not all(1 <= count <= _MAX_COUNT for count in counts):
        raise UserError(
            f"{path}: PCD header: COUNT: expected 1 to {_MAX_COUNT:,} values a field, found "
            f"{' '.join(map(str, counts))}"
        )
    viewpoint = _viewpoint(entries.get("VIEWPOINT", []))
    return _Header(names, dtypes, counts, points, data, offset, viewpoint, _shape(entries))


def _shape(entries: dict[str, list[str]]) -> tuple[int, int]:
    """Return rows and columns of an organised cloud; one row where the header does not say."""
    try:
        return int(entries["HEIGHT"][0]), int(entries["WIDTH"][0])
    except (KeyError, ValueError, IndexError):
        return 1, 0


def _viewpoint(words: list[str]) -> Position | None:
    """Return where the sensor stood; None for the default, and for what is no viewpoint."""
    try:
        numbers = tuple(float(word) for word in words)
    except ValueError:
        return None
    if len(numbers) != len(_NO_VIEWPOINT) or not all(map(math.isfinite, numbers)):
        return None
    return None if numbers == _NO_VIEWPOINT else (numbers[0], numbers[1], numbers[2])


def _columns(body: bytes, header: _Header, path: Path) -> dict[str, NDArray[np.generic]]:
    """Split the data into one array per field (the first value of fields with several)."""
    record = header.record()
    expected = header.points * record.itemsize
    if header.data == "ascii":
        return _ascii_columns(body, header, path)
    if header.data == "binary":
        if len(body) < expected:
            raise UserError(f"{path}: data: expected {expected} bytes, found {len(body)}")
        rows = np.frombuffer(body, record, header.points)
        return {
            name: rows[key][:, 0]
            for name, key in zip(header.names, record.names or (), strict=True)
        }
    if header.data != "binary_compressed":
        raise UserError(
            f"{path}: DATA: expected ascii, binary or binary_compressed, found {header.data}"
        )
    check_decoded_bytes(path, expected, "compressed data")
    sizes = [int.from_bytes(body[start : start + 4], "little") for start in (0, 4)]
    if len(body) < 8 + sizes[0] or sizes[1] != expected:
        raise UserError(f"{path}: compressed data: {expected} bytes do not fit what is there")
    try:
        plain = lzf_decompress(body[8 : 8 + sizes[0]], expected)
    except ValueError as error:
        raise UserError(f"{path}: {error}") from error
    columns, start = {}, 0
    for name, dtype, count in zip(header.names, header.dtypes, header.counts, strict=True):
        values = np.frombuffer(plain, dtype, header.points * count, start)
        columns[name] = values[::count]
        start += values.nbytes
    return columns


def _ascii_columns(body: bytes, header: _Header, path: Path) -> dict[str, NDArray[np.generic]]:
    """Parse one line of numbers per point."""
    words = body.split()
    width = sum(header.counts)
    if len(words) < header.points * width:
        raise UserError(
            f"{path}: data: expected {header.points * width} numbers, found {len(words)}"
        )
    try:
        table = np.array(words[: header.points * width], np.float64).reshape(-1, width)
    except ValueError as error:
        raise UserError(f"{path}: data: expected numbers ({error})") from error
    starts = np.cumsum([0, *header.counts[:-1]])
    fields = zip(header.names, header.dtypes, starts, strict=True)
    return {name: table[:, start].astype(dtype) for name, dtype, start in fields}


def _unpack(packed: NDArray[np.generic]) -> Float32Array:  # [N] -> [N, 3]
    """Split 0xAARRGGBB words into sRGB in [0, 1]."""
    words = np.ascontiguousarray(packed).view(np.uint32)
    channels = [(words >> shift) & 255 for shift in (16, 8, 0)]
    return (np.stack(channels, axis=1) / 255.0).astype(np.float32)
