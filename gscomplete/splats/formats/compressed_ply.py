"""SuperSplat's compressed PLY: trained splats packed to 16 bytes each; written through gsply.

Conventions
-----------
* Splats come in chunks of 256; an element ``chunk`` holds each chunk's ranges of position, log
  scale and (in newer files) colour, an element ``vertex`` four 32-bit words per splat, and an
  optional element ``sh`` one byte per ``f_rest`` coefficient, channel-major, over [-4, 4].
* A field of b bits stands for value / (2^b - 1) in [0, 1], to be stretched over its range.
* Opacity is stored linear, colour as 0.5 + SH_C0 * f_dc, rotation as the three smaller components
  of the unit quaternion (w, x, y, z) in +/- sqrt(1/2), led by the index of the largest.
* Values are quantised: such a file is an input to look at or convert, not one to pass through.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from gscomplete.splats.filters import middle_and_extent
from gscomplete.splats.formats.gsply_values import to_gsply
from gscomplete.splats.ply_files.header import Element, PlyError, PlyHeader, read_header
from gscomplete.splats.ply_files.payload import read_payload
from gscomplete.splats.record import SH_C0, Splats
from gscomplete.util.arrays import Float64Array
from gscomplete.util.atomic import atomic_path
from gscomplete.util.optional import import_optional

CHUNK_ROWS = 256
"""Splats that share one row of ranges."""

_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_POSITION_RANGE = tuple(f"{end}_{axis}" for end in ("min", "max") for axis in "xyz")
_POSITION_CODES = (2**11 - 1, 2**10 - 1, 2**11 - 1)
"""Largest codes of a position's fields."""
_LEAST_SCALE = math.exp(-20.0)
"""Smaller scales are written as this one."""
_COARSE_STEP = 4 / 1023
"""Steps of positions, over the splats' extent, that are told to be lost: those of a range four
times as wide, which only floaters make."""
_SCALE_RANGE = tuple(f"{end}_scale_{axis}" for end in ("min", "max") for axis in "xyz")
_COLOR_RANGE = tuple(f"{end}_{channel}" for end in ("min", "max") for channel in "rgb")


def read_compressed_ply(path: str | Path) -> Splats:
    """Read a SuperSplat ``.compressed.ply`` as activated float32 splats in the file frame.

    Args:
        path: the file.

    Returns:
        N splats; positions and scales are as coarse as the file's 11 and 10 bits.

    Raises:
        PlyError: the file is not such a file, or it is truncated.
    """
    path = Path(path)
    header, vertex, chunk = _layout(path)
    payload = read_payload(path, header, vertex)
    order = header.byte_order
    ranges = _columns(payload.before, chunk, order)
    words = _columns(payload.records.tobytes(), vertex, order)

    position, scale = words["packed_position"], words["packed_scale"]
    color = words["packed_color"]
    base = np.stack([_bits(color, shift, 8) for shift in (24, 16, 8)], axis=1)
    if set(_COLOR_RANGE) <= set(ranges):
        base = _stretch(base, ranges, _COLOR_RANGE)
    higher = _higher_sh(path, header, vertex.count, payload.after)
    sh = np.concatenate([((base - 0.5) / SH_C0)[:, None], higher], axis=1)
    arrays = (
        _stretch(_unpack_11_10_11(position), ranges, _POSITION_RANGE),
        _unpack_rotation(words["packed_rotation"]),
        np.exp(_stretch(_unpack_11_10_11(scale), ranges, _SCALE_RANGE)),
        _bits(color, 0, 8),
        sh,
    )
    return Splats(*(torch.from_numpy(array.astype(np.float32)) for array in arrays))


def write_compressed_ply(path: Path, splats: Splats) -> tuple[str, ...]:
    """Write splats as such a file; return what is lost.

    Args:
        path: destination.
        splats: activated, finite.

    Raises:
        UserError: the file cannot be written.
    """
    gsply = import_optional("gsply", "writing compressed.ply files")
    with atomic_path(path) as temporary:
        temporary.write_bytes(gsply.compress_to_bytes(to_gsply(gsply, splats)))
        steps = _position_steps(temporary)
    notes = ["values are quantised", "the order of splats"]
    tiny = int((splats.scales < _LEAST_SCALE).any(dim=1).sum())
    if tiny:
        notes.append(f"scales below {_LEAST_SCALE:.2g} of {tiny:,} splats")
    coarse = steps > _COARSE_STEP * middle_and_extent(splats.means.numpy())[1]
    if coarse.any():
        notes.append(
            f"positions of {int(coarse.sum()):,} splats, which share their ranges with floaters "
            f"(steps of up to {float(steps.max()):.2g}; leave floaters out with "
            "splatcomplete-data clean)"
        )
    return tuple(notes)


def _position_steps(path: Path) -> Float64Array:  # [N]
    """Return how coarse each splat's position is: the largest step along an axis.

    Args:
        path: a file of ``read_compressed_ply``.

    Returns:
        Steps in the units of positions: the extent of a splat's chunk over 2,047 (y: 1,023).
    """
    header, vertex, chunk = _layout(path)
    payload = read_payload(path, header, vertex)
    ranges = _columns(payload.before, chunk, header.byte_order)
    low, high = (
        np.stack([ranges[name].astype(np.float64) for name in names], axis=1)
        for names in (_POSITION_RANGE[:3], _POSITION_RANGE[3:])
    )
    steps = ((high - low) / _POSITION_CODES).max(axis=1)
    return np.repeat(steps, CHUNK_ROWS)[: vertex.count]


def _layout(path: Path) -> tuple[PlyHeader, Element, Element]:
    """Read a file's header; return it with its elements of splats and of chunks.

    Raises:
        PlyError: the file is not such a file.
    """
    header = read_header(path)
    vertex, chunk = header.find("vertex"), header.find("chunk")
    if vertex is None or chunk is None or header.elements[0] is not chunk:
        message = "expected a SuperSplat compressed PLY with an element 'chunk' before 'vertex'"
        raise PlyError(path, "not_a_splat_file", message)
    _check_properties(path, header, vertex, _PACKED, "u4")
    _check_properties(path, header, chunk, _POSITION_RANGE + _SCALE_RANGE, "f4")
    expected = -(-vertex.count // CHUNK_ROWS)
    if chunk.count != expected or header.elements[1] is not vertex:
        message = f"element chunk: expected {expected} rows next to the vertices"
        raise PlyError(path, "bad_payload", f"{message}, found {chunk.count}")
    return header, vertex, chunk


def _check_properties(
    path: Path, header: PlyHeader, element: Element, names: tuple[str, ...], code: str
) -> None:
    """Check that an element has some properties of one type."""
    found = {p.name: p.code for p in element.properties if p.count_code is None}
    for name in names:
        if found.get(name) != code or element.has_lists or header.format == "ascii":
            message = f"element {element.name}: expected a binary property {name} ({code})"
            raise PlyError(path, "missing_property", f"{message}, found {element.names}")


def _columns(data: bytes, element: Element, order: str) -> dict[str, NDArray]:
    """View the rows of an element by property name."""
    rows = np.frombuffer(data, element.row_dtype(order), element.count)
    return {name: rows[f"p{i}"] for i, name in enumerate(element.names)}


def _bits(words: NDArray, shift: int, count: int) -> Float64Array:  # [N]
    """Return a bit field of 32-bit words as a fraction in [0, 1]."""
    top = (1 << count) - 1
    return ((words >> np.uint32(shift)) & np.uint32(top)) / top


def _unpack_11_10_11(words: NDArray) -> Float64Array:  # [N] -> [N, 3]
    """Return the three fractions of a position or scale word."""
    return np.stack([_bits(words, 21, 11), _bits(words, 11, 10), _bits(words, 0, 11)], axis=1)


def _stretch(
    fractions: Float64Array,  # [N, 3]
    ranges: dict[str, NDArray],  # [chunks] each
    names: tuple[str, ...],  # 3 minima, 3 maxima
) -> Float64Array:  # [N, 3]
    """Spread fractions over the ranges of their chunks."""
    ends = np.stack([ranges[name].astype(np.float64) for name in names], axis=1)
    ends = np.repeat(ends, CHUNK_ROWS, axis=0)[: len(fractions)]
    return ends[:, :3] * (1 - fractions) + ends[:, 3:] * fractions


def _unpack_rotation(words: NDArray) -> Float64Array:  # [N] -> [N, 4]
    """Return unit quaternions (w, x, y, z); the largest component is positive."""
    small = np.stack([_bits(words, shift, 10) for shift in (20, 10, 0)], axis=1) - 0.5
    small *= math.sqrt(2)
    largest = np.sqrt(np.maximum(0, 1 - (small**2).sum(axis=1)))
    index = (words >> np.uint32(30)).astype(np.int64)
    places = np.arange(4)[None]
    # the components left of the largest keep their place, those right of it move up by one
    quaternions = np.take_along_axis(small, np.clip(places - (places > index[:, None]), 0, 2), 1)
    np.put_along_axis(quaternions, index[:, None], largest[:, None], 1)
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def _higher_sh(
    path: Path, header: PlyHeader, count: int, data: bytes
) -> Float64Array:  # [N, K - 1, 3]
    """Return the coefficients above the base band; none without an element ``sh``.

    The end codes 0 and 255 stand for -4 and 4, the others for the middle of their interval.
    """
    element = header.find("sh")
    if element is None:
        return np.zeros((count, 0, 3))
    rest = len(element.properties)
    names = tuple(f"f_rest_{i}" for i in range(rest))
    _check_properties(path, header, element, names, "u1")
    if rest not in (9, 24, 45) or element.count != count or len(data) < count * rest:
        message = f"element sh: expected 9, 24 or 45 bytes for each of {count} splats"
        raise PlyError(path, "sh_layout", f"{message}, found {len(data)} bytes, {rest} per splat")
    columns = _columns(data, element, header.byte_order)
    codes = np.stack([columns[name] for name in names], axis=1).astype(np.float64)
    middles = np.where(codes == 0, 0.0, np.where(codes == 255, 1.0, (codes + 0.5) / 256))
    return ((middles - 0.5) * 8).reshape(count, 3, rest // 3).transpose(0, 2, 1)
