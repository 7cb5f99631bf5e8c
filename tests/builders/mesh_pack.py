"""A small pack of training meshes, written to a folder."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from PIL import Image

_COLUMNS = ("id", "split", "noun", "caption", "source", "licence", "author", "colour")
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


def write_pack(folder: Path) -> Path:
    """Write two boxes to train on and one held out: red above blue, without colour, textured."""
    rows = [
        ("a/red", "train", "box", "red box", "one", "CC0", "me", "flat"),
        ("a/plain", "train", "box", "plain box", "m3-basemesh", "CC0", "me", "none"),
        ("a/picture", "validation", "box", "picture box", "gso", "CC0", "me", "texture"),
    ]
    (folder / "a").mkdir(parents=True)
    with (folder / "MANIFEST.tsv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, delimiter="\t")
        writer.writerow(_COLUMNS)
        writer.writerows(rows)
    shape = {
        "v": (_CORNERS * 4095).astype(np.uint16),
        "ext": np.array([0.5, 0.5, 1.0], np.float32),
        "f": _FACES.astype(np.uint16),
        "size_m": np.float32(np.nan),
    }
    palette = np.array([[255, 0, 0], [0, 0, 255]], np.uint8)
    colors = {"pal": palette, "fc": (np.arange(12) >= 10).astype(np.uint8)}
    for name in ("red", "plain"):
        np.savez(folder / "a" / f"{name}.npz", **shape, **colors)
    # Six blocks of 8 x 8 px, three in a row: the first two faces green, the others grey.
    picture = np.full((24, 24, 3), 128, np.uint8)
    picture[:8, :8] = (0, 255, 0)
    stored = io.BytesIO()
    Image.fromarray(picture).save(stored, "PNG")
    texture = np.frombuffer(stored.getvalue(), np.uint8)
    np.savez(folder / "a" / "picture.npz", **shape, tex=texture, s=np.int64(8))
    return folder
