"""Depth images, photos, masks, and files that state their camera."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

_WIDTH, _HEIGHT = 16, 12


def picture_seeds(folder: Path) -> list[tuple[str, Callable[[Path], object]]]:
    """Write the files; return each with its reader."""
    from PIL import Image

    from splatcomplete_data.multiview.photos.images import read_photo
    from splatcomplete_data.pictures import read_mask
    from splatcomplete_data.singleview.depth_file import read_depth
    from splatcomplete_data.singleview.intrinsics import read_intrinsics

    depth = np.full((_HEIGHT, _WIDTH), 1500, np.uint16)
    for name in ("d.png", "d.pgm"):
        Image.fromarray(depth).save(folder / name)
    np.save(folder / "d.npy", depth)
    camera = np.array([[20.0, 0, 8], [0, 20, 6], [0, 0, 1]])
    np.savez(folder / "d.npz", depth=depth[None], intrinsics=camera[None])
    Image.fromarray(depth.astype(np.float32)).save(folder / "d.tif")
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 255, (_HEIGHT, _WIDTH, 3), np.uint8)).save(folder / "p.jpg")
    Image.fromarray(rng.integers(0, 2, (_HEIGHT, _WIDTH), np.uint8) * 255).save(folder / "m.png")
    (folder / "k.txt").write_text("20 0 8\n0 20 6\n0 0 1\n")
    (folder / "k.json").write_text(json.dumps({"fx": 20, "fy": 20.5, "cx": 8, "cy": 6, "w": 16}))
    (folder / "K.json").write_text(json.dumps({"K": camera.tolist(), "width": 16, "height": 12}))

    def intrinsics(path: Path) -> object:
        return read_intrinsics(path, _WIDTH, _HEIGHT)

    return [
        *((f"d.{kind}", read_depth) for kind in ("png", "pgm", "npy", "npz", "tif")),
        ("p.jpg", read_photo),
        ("m.png", read_mask),
        *((name, intrinsics) for name in ("k.txt", "k.json", "K.json")),
    ]
