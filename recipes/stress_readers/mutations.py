"""Damage to a file as a function of a seed and a number.

Half of the files are damaged as bytes, the other half inside their packing (``packings``), where
checksums and lengths do not give the damage away.
"""

from __future__ import annotations

import re

import numpy as np

from recipes.stress_readers.packings import damage_inside

_NUMBERS = (b"0", b"-1", b"1", b"255", b"65536", b"1000000000", b"99999999999999999999", b"-0.0")
_NUMBERS += (
    b"1e9",
    b"1e39",
    b"1e400",
    b"-1e308",
    b"NaN",
    b"Infinity",
    b"nan",
    b"null",
    b"[]",
    b"{}",
)
_NUMBERS += (b"", b'"x"', b"true", b"0x10", b"1_000", b"\xa0")


def mutate(name: str, data: bytes, seed: int, number: int) -> bytes:
    """Return a damaged copy of a file's bytes.

    Args:
        name: of the file, which says how it is packed.
        data: its bytes.
        seed: of all files.
        number: of this one.
    """
    rng = np.random.default_rng((seed, number))
    if rng.random() < 0.5:
        damaged = damage_inside(name, data, rng, damage_bytes)
        if damaged is not None:
            return damaged
    return damage_bytes(data, rng)


def damage_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Change, remove, double, overwrite or cut off bytes, or put other numbers, up to four times.

    Args:
        data: what is damaged.
        rng: says how.
    """
    raw = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        if not raw:
            break
        kind = int(rng.integers(8))
        if kind >= 6:
            raw = _other_number(raw, rng)
            continue
        start = int(rng.integers(len(raw)))
        if rng.random() < 0.5:  # headers deserve more than their share
            start = int(rng.integers(min(len(raw), 300)))
        stop = min(len(raw), start + int(rng.integers(1, 24)))
        if kind == 0:
            raw[start] = int(rng.integers(256))
        elif kind == 1:
            del raw[start:stop]
        elif kind == 2:
            raw[start:start] = raw[start:stop]
        elif kind == 3:
            raw[start:stop] = bytes(rng.integers(256, size=stop - start, dtype=np.uint8))
        elif kind == 4:
            raw[start:stop] = bytes([255 if rng.random() < 0.5 else 0]) * (stop - start)
        else:
            del raw[start:]
    return bytes(raw)


def _other_number(raw: bytearray, rng: np.random.Generator) -> bytearray:
    """Put another number, or what is none, in place of one that is written out."""
    found = list(re.finditer(rb"-?[0-9][0-9.e+-]*", bytes(raw[:20_000])))
    if not found:
        return raw
    match = found[int(rng.integers(len(found)))]
    other = _NUMBERS[int(rng.integers(len(_NUMBERS)))]
    return raw[: match.start()] + bytearray(other) + raw[match.end() :]
