"""Damage inside a file's packing, so that the packing itself stays valid.

Conventions
-----------
* A file's kind follows from its name, and from its first bytes where one name has several kinds.
* Trees (JSON, YAML) are damaged as values: replaced, removed, renamed, doubled, exchanged.
* Texts are damaged as lines and words; packed bytes as bytes, with lengths and checksums made anew.
"""

from __future__ import annotations

import gzip
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from recipes.stress_readers.trees import damage_tree

Damage = Callable[[bytes, np.random.Generator], bytes]

_TEXTS = (".obj", ".mtl", ".off", ".xyz", ".txt", ".csv", ".pcd", ".ply", ".dae")
_MOST_TEXT = 20_000
"""Bytes of the beginning in which lines are damaged."""
_PNG_START = b"\x89PNG\r\n\x1a\n"


def damage_inside(
    name: str, data: bytes, rng: np.random.Generator, damage_bytes: Damage
) -> bytes | None:
    """Damage what a file has packed.

    Args:
        name: of the file.
        data: its bytes, undamaged.
        rng: says how.
        damage_bytes: how to damage bytes that are unpacked.

    Returns:
        The file with valid packing; None where its kind has none.
    """
    suffix = "." + name.lower().rpartition(".")[2]
    if suffix in (".json", ".gltf"):
        return _json(damage_tree(json.loads(data), rng))
    if suffix == ".jsonl":
        return _json_line(data, rng)
    if suffix == ".yaml":
        return _yaml(data, rng)
    if suffix == ".safetensors":
        return _safetensors(data, rng, damage_bytes)
    if suffix == ".glb":
        return _glb(data, rng, damage_bytes)
    if suffix in (".npz", ".pt", ".sog") and data[:2] == b"PK":
        return _zip(data, rng, damage_bytes)
    if suffix == ".spz" and data[:2] == b"\x1f\x8b":
        return gzip.compress(damage_bytes(gzip.decompress(data), rng), 1, mtime=0)
    if suffix == ".png":
        return _png(data, rng, damage_bytes)
    if suffix in _TEXTS:
        return _lines(data, rng)
    return None


def _json(value: Any) -> bytes:
    """Write JSON, with NaN and infinities as Python writes them."""
    return json.dumps(value).encode("utf-8", "surrogatepass")


def _json_line(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage one line of JSON lines."""
    lines = data.splitlines()
    place = int(rng.integers(len(lines)))
    lines[place] = _json(damage_tree(json.loads(lines[place]), rng))
    return b"\n".join(lines)


def _yaml(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage a YAML file as a tree."""
    import yaml

    text: str = yaml.safe_dump(damage_tree(yaml.safe_load(data), rng), allow_unicode=True)
    return text.encode()


def _safetensors(data: bytes, rng: np.random.Generator, damage_bytes: Damage) -> bytes:
    """Damage the header of a safetensors file as a tree, or its tensors."""
    size = int.from_bytes(data[:8], "little")
    header, tensors = data[8 : 8 + size], data[8 + size :]
    if rng.random() < 0.7:
        header = _json(damage_tree(json.loads(header), rng))
    else:
        tensors = damage_bytes(tensors, rng)[: len(tensors)].ljust(len(tensors), b"\xff")
    return len(header).to_bytes(8, "little") + header + tensors


def _glb(data: bytes, rng: np.random.Generator, damage_bytes: Damage) -> bytes:
    """Damage the JSON of a GLB file as a tree, or its buffer."""
    chunks = list(_glb_chunks(data))
    place = int(rng.integers(len(chunks))) if rng.random() < 0.3 else 0
    kind, content = chunks[place]
    if kind == b"JSON":
        content = _json(damage_tree(json.loads(content), rng))
    else:
        content = damage_bytes(content, rng)
    chunks[place] = kind, content
    body = b""
    for kind, content in chunks:
        content += (b" " if kind == b"JSON" else b"\0") * (-len(content) % 4)
        body += struct.pack("<I", len(content)) + kind + content
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def _glb_chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield kind and content of a GLB file's chunks."""
    at = 12
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "little")
        yield data[at + 4 : at + 8], data[at + 8 : at + 8 + size]
        at += 8 + size


def _zip(data: bytes, rng: np.random.Generator, damage_bytes: Damage) -> bytes:
    """Damage a member of a zip file, or leave it out."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
    place = int(rng.integers(len(members)))
    name, content = members.pop(place)
    if rng.random() < 0.9:
        members.insert(place, (name, damage_bytes(content, rng)))
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name), content)
    return packed.getvalue()


def _png(data: bytes, rng: np.random.Generator, damage_bytes: Damage) -> bytes:
    """Damage a chunk of a PNG file; that of pixels is unpacked for it."""
    chunks = []
    at = len(_PNG_START)
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += 12 + size
    place = int(rng.integers(len(chunks)))
    kind, content = chunks[place]
    if kind == b"IDAT" and rng.random() < 0.7:
        content = zlib.compress(damage_bytes(zlib.decompress(content), rng), 1)
    else:
        content = damage_bytes(content, rng)
    chunks[place] = kind, content
    packed = _PNG_START
    for kind, content in chunks:
        packed += struct.pack(">I", len(content)) + kind + content
        packed += struct.pack(">I", zlib.crc32(kind + content))
    return packed


def _lines(data: bytes, rng: np.random.Generator) -> bytes:
    """Remove, double or exchange lines of a text's beginning, or exchange words of two lines."""
    lines = data[:_MOST_TEXT].split(b"\n")
    rest = data[_MOST_TEXT:]
    one, two = (int(place) for place in rng.integers(len(lines), size=2))
    kind = int(rng.integers(4))
    if kind == 0:
        del lines[one]
    elif kind == 1:
        lines[one:one] = [lines[two]] * int(rng.integers(1, 4))
    elif kind == 2:
        lines[one], lines[two] = lines[two], lines[one]
    else:
        words, others = lines[one].split(b" "), lines[two].split(b" ")
        words[int(rng.integers(len(words)))] = others[int(rng.integers(len(others)))]
        lines[one] = b" ".join(words)
    return b"\n".join(lines) + rest
