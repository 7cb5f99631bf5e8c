"""Splat PLY files written the slow, obvious way, for the tests of readers and writers."""

from __future__ import annotations

import numpy as np

from gscomplete.splats.ply_files.header import SCALAR_CODES

FORMATS = ("ascii", "binary_little_endian", "binary_big_endian")


def schema(rest: int) -> list[str]:
    names = [*"xyz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(rest))]
    return [*names, "opacity", "scale_0", "scale_1", "scale_2", *(f"rot_{i}" for i in range(4))]


def make_ply(
    table: dict[str, np.ndarray],
    form: str = "binary_little_endian",
    types: dict[str, str] | None = None,
    comments: tuple[str, ...] = (),
    before: tuple[str, bytes] = ("", b""),
    after: tuple[str, bytes] = ("", b""),
    newline: str = "\n",
) -> bytes:
    """The slow obvious writer: one value at a time."""
    types = types or {}
    count = len(next(iter(table.values())))
    lines = ["ply", f"format {form} 1.0", *(f"comment {text}" for text in comments)]
    lines += [*before[0].splitlines(), f"element vertex {count}"]
    lines += [f"property {types.get(name, 'float')} {name}" for name in table]
    lines += [*after[0].splitlines(), "end_header", ""]
    body = bytearray()
    order = ">" if form == "binary_big_endian" else "<"
    for i in range(count):
        for j, (name, values) in enumerate(table.items()):
            code = SCALAR_CODES[types.get(name, "float")]
            value = np.array(values[i]).astype(order + code)
            if form == "ascii":
                body += (" " if j else "").encode() + str(value.item()).encode()
            else:
                body += value.tobytes()
        if form == "ascii":
            body += newline.encode()
    return newline.join(lines).encode() + before[1] + bytes(body) + after[1]


def random_table(count: int, rest: int, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {name: rng.normal(size=count).astype(np.float32) for name in schema(rest)}
