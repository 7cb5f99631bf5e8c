"""What an SPZ file unpacks to, counted before anything is made of it.

Conventions
-----------
* Versions 1 to 3 are one gzip stream: a header of 16 bytes, then 19 bytes (version 3: 20) and the
  harmonics of every splat. Version 4 has its header and a table of its zstd streams in the open.
* What follows the splats is an extension, and may be small.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

from gscomplete.errors import UserError
from gscomplete.util.limits import check_decoded_bytes
from splatcomplete_data.optional import import_optional

_MAGIC = b"NGSP"
_HARMONICS = {0: 0, 1: 3, 2: 8, 3: 15}
_BLOCK_BYTES = 1 << 20
_EXTENSION_BYTES = 1 << 20
_FIRST_ZSTD_VERSION = 4


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
