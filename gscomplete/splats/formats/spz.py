"""Niantic's SPZ: quantised splats in gzip (versions 1 to 3) or zstandard (4), by way of gsply.

Conventions
-----------
* SPZ stores right-up-back axes, PLY files of the same object right-down-front: reading turns by
  ``TURN``, 180 degrees about x, harmonics too, and so does writing where nothing else is said.
* What a file unpacks to is counted before anything is made of it.
* Versions 1 to 3 are one gzip stream: a header of 16 bytes, then 19 bytes (version 3: 20) and the
  harmonics of every splat. Version 4 has its header and a table of its zstd streams in the open.
* What follows the splats is an extension, and may be small.
* Positions are fixed-point numbers of 24 bits; the header says how many of them are fractional
  (``write_spz`` takes as many as ``FINE_STEP`` needs, if the farthest splat leaves so many). A byte
  of a log scale holds ``SCALE_RANGE``.
"""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from gscomplete.errors import UserError
from gscomplete.splats.filters import middle_and_extent
from gscomplete.splats.formats.gsply_values import to_gsply
from gscomplete.splats.record import Splats
from gscomplete.splats.transform import Similarity, transform_splats
from gscomplete.util.atomic import atomic_path
from gscomplete.util.limits import check_decoded_bytes
from gscomplete.util.optional import import_optional

SpzVersion = Literal[3, 4]
"""3: gzip, read everywhere; 4: zstandard, smaller."""
TURN = Similarity(1.0, torch.diag(torch.tensor([1.0, -1.0, -1.0])), torch.zeros(3))

SCALE_RANGE = (math.exp(-10.0), math.exp(-10.0 + 255 / 16))
"""Scales that the format holds; others are written as the nearest of them."""
_LARGEST_BASE = 0.5 / 0.15
"""A byte of a base coefficient holds 0.15 of it, about one half."""
COARSEST_STEP = 1e-3
"""Positions in coarser steps, over the extent of the splats, are refused."""
FINE_STEP = 1e-5
"""Finer steps, over the extent of the splats, would only make larger files."""

_MAGIC = b"NGSP"
_HARMONICS = {0: 0, 1: 3, 2: 8, 3: 15}
_BLOCK_BYTES = 1 << 20
_EXTENSION_BYTES = 1 << 20
_FIRST_ZSTD_VERSION = 4
_LARGEST_FIXED = 2**23 - 1
_FEWEST_BITS, _MOST_BITS = 1, 24
"""Fractional bits that readers take."""
_HALF_SCALE_STEP = math.exp(1 / 32)


def read_spz(path: Path) -> Splats:
    """Read an SPZ file of version 1 to 4, in the frame of a PLY.

    Raises:
        UserError: it is damaged, or unpacks to more than it says.
    """
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
    return transform_splats(raw, TURN)


def write_spz(
    path: Path, splats: Splats, version: SpzVersion = 3, turn: Similarity = TURN
) -> tuple[str, ...]:
    """Write splats as SPZ; return what is lost.

    Args:
        path: destination.
        splats: activated, finite.
        version: version of the file.
        turn: from the splats' axes to SPZ's.

    Raises:
        UserError: positions would be in steps coarser than ``COARSEST_STEP``, or the file cannot
            be written.
    """
    gsply = import_optional("gsply", "writing SPZ files")
    turned = transform_splats(splats, turn)
    bits = _fractional_bits(path, turned)
    with atomic_path(path) as temporary:
        gsply.write_spz(temporary, to_gsply(gsply, turned), version=version, fractional_bits=bits)
    return (f"values are quantised (positions in steps of {2.0**-bits:.2g})", *_clipped(splats))


def _fractional_bits(path: Path, splats: Splats) -> int:
    """Return how many fractional bits positions get, so that the farthest coordinate fits.

    Raises:
        UserError: the steps are too coarse for the splats' extent, or no number of bits is enough.
    """
    reach = max(float(splats.means.double().abs().max()), 2.0**-_MOST_BITS)
    extent = middle_and_extent(splats.means.numpy())[1] or float(
        splats.scales.clamp(*SCALE_RANGE).max()
    )
    needed = max(math.ceil(-math.log2(FINE_STEP * extent)), _FEWEST_BITS)
    bits = min(_MOST_BITS, needed, math.floor(math.log2(_LARGEST_FIXED / reach)))
    step = 2.0**-bits
    if bits < _FEWEST_BITS or step > COARSEST_STEP * extent:
        raise UserError(
            f"{path}: SPZ: expected positions in steps of at most 1/{1 / COARSEST_STEP:.0f} of the "
            f"splats' extent of {extent:.3g}, found steps of {step:.3g} (the farthest coordinate "
            f"is {reach:.3g}); write .ply or .glb, or leave floaters out "
            "(splatcomplete-data clean)"
        )
    return bits


def _clipped(splats: Splats) -> tuple[str, ...]:
    """Tell how many splats have values beyond what the format holds."""
    low, high = SCALE_RANGE
    notes = []
    for count, word, end in (
        (int((splats.scales < low / _HALF_SCALE_STEP).any(dim=1).sum()), "below", low),
        (int((splats.scales > high * _HALF_SCALE_STEP).any(dim=1).sum()), "above", high),
    ):
        if count:
            notes.append(f"scales {word} {end:.3g} of {count:,} splats (written as {end:.3g})")
    colors = int(((splats.sh[:, 0].abs() > _LARGEST_BASE).any(dim=1)).sum())
    if colors:
        notes.append(f"colours of {colors:,} splats beyond what a byte holds")
    higher = int((splats.sh[:, 1:].abs() > 1.0).flatten(1).any(dim=1).sum())
    if higher:
        notes.append(f"harmonics beyond 1 of {higher:,} splats (written as 1)")
    return tuple(notes)


def check_spz_size(path: Path) -> None:
    """Check that a file holds what its header says, and that this is not too much.

    Raises:
        UserError: it holds more, or is no SPZ file.
    """
    try:
        packed = path.read_bytes()
        if packed.startswith(_MAGIC):
            _check_streams(path, packed)
        else:
            _count_gzip(path, packed)
    except (OSError, zlib.error, struct.error) as error:
        raise UserError(f"{path}: cannot read it as SPZ ({error})") from error


def _expected_bytes(path: Path, head: bytes) -> int:
    """Return what a header's splats need."""
    magic, version, count, degree = struct.unpack_from("<4sIIB", head)
    if magic != _MAGIC or degree not in _HARMONICS:
        raise UserError(f"{path}: cannot read it as SPZ (no NGSP header)")
    expected = int(count) * ((20 if version >= 3 else 19) + 3 * _HARMONICS[degree])
    check_decoded_bytes(path, expected, f"{count:,} splats")
    return expected


def _count_gzip(path: Path, packed: bytes) -> None:
    """Unpack a gzip file block by block, and stop where it holds more than it says."""
    total, most, head = 0, 0, b""
    rest = packed
    while rest:
        stream = zlib.decompressobj(wbits=31)
        while rest and not stream.eof:
            block = stream.decompress(rest, _BLOCK_BYTES)
            rest = stream.unconsumed_tail
            total += len(block)
            if len(head) < 16:
                head += block[:16]
                if len(head) < 16:
                    continue
                most = 16 + _expected_bytes(path, head) + _EXTENSION_BYTES
            if total > most:
                count = int.from_bytes(head[8:12], "little")
                raise UserError(
                    f"{path}: expected at most {most:,} bytes of {count:,} splats, found more"
                )
        rest = stream.unused_data
    if len(head) < 16:
        raise UserError(f"{path}: cannot read it as SPZ (no NGSP header)")


def _check_streams(path: Path, packed: bytes) -> None:
    """Check that zstd streams unpack to what the header says."""
    expected = _expected_bytes(path, packed)
    (version,) = struct.unpack_from("<I", packed, 4)
    if version < _FIRST_ZSTD_VERSION:
        raise UserError(f"{path}: cannot read it as SPZ (version {version} without gzip)")
    zstandard = import_optional("zstandard", "reading SPZ files of version 4")
    streams, start = struct.unpack_from("<BI", packed, 15)
    offset = start + 16 * streams
    for index in range(streams):
        stored, _ = struct.unpack_from("<QQ", packed, start + 16 * index)
        try:
            size = zstandard.frame_content_size(packed[offset : offset + min(stored, 64)])
        except zstandard.ZstdError as error:
            raise UserError(f"{path}: cannot read it as SPZ ({error})") from error
        if size > expected:
            raise UserError(f"{path}: expected at most {expected:,} bytes a stream, found {size:,}")
        offset += stored
