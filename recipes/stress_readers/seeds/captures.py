"""Photos with poses: transforms.json, COLMAP's models as bytes and as text, finished captures."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

_SIZE_PX = 8
_PHOTOS = 4


def capture_seeds(folder: Path) -> list[tuple[str, Callable[[Path], object]]]:
    """Write the files; return each with its reader."""
    from PIL import Image

    from gscomplete.splats import write_splats
    from recipes.benchmarks.formats.ply_io import random_splats
    from splatcomplete_data.multiview.photos.colmap_model import read_colmap
    from splatcomplete_data.multiview.photos.transforms_json import read_transforms
    from splatcomplete_data.multiview.scene import read_scene

    rng = np.random.default_rng(3)
    for index in range(_PHOTOS):
        picture = rng.integers(0, 255, (_SIZE_PX, _SIZE_PX, 3), np.uint8)
        Image.fromarray(picture).save(folder / f"{index}.png")
    turn = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]])
    frames = [
        {
            "file_path": f"{index}.png",
            "transform_matrix": np.linalg.matrix_power(turn, index).tolist(),
        }
        for index in range(_PHOTOS)
    ]
    transforms = {"camera_angle_x": 0.8, "w": _SIZE_PX, "h": _SIZE_PX, "k1": 0.01, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(transforms))
    camera = {
        "camera_from_world": np.linalg.inv(turn).tolist(),
        "focal_px": [9.0, 9.0],
        "center_px": [4.0, 4.0],
        "width": _SIZE_PX,
        "height": _SIZE_PX,
    }
    capture = {"schema": "splatcomplete.capture", "status": "finished", "cameras": [camera]}
    capture |= {"up": [0, -1, 0], "look_at": [0, 0, 0], "extent": 2.0}
    (folder / "capture.json").write_text(json.dumps(capture))
    write_splats(folder / "splats.ply", random_splats(40, 1))
    for model in ("bytes", "text"):
        (folder / model).mkdir()
    _write_bytes(folder / "bytes")
    _write_text(folder / "text")
    names = [f"bytes/{name}.bin" for name in ("cameras", "images", "points3D")]
    names += [f"text/{name}.txt" for name in ("cameras", "images", "points3D")]
    return [
        ("transforms.json", lambda path: read_transforms(path, None, path.parent)),
        ("capture.json", lambda path: read_scene(path.parent)),
        *((name, lambda path: read_colmap(path.parent, path.parents[1])) for name in names),
    ]


def _write_bytes(model: Path) -> None:
    """Write a COLMAP model as bytes: a PINHOLE camera, photos that see one point."""
    camera = struct.pack("<iiQQ4d", 1, 1, _SIZE_PX, _SIZE_PX, 9.0, 9.0, 4.0, 4.0)
    (model / "cameras.bin").write_bytes(struct.pack("<Q", 1) + camera)
    images = struct.pack("<Q", _PHOTOS)
    for index in range(_PHOTOS):
        images += struct.pack("<i7di", index + 1, 1, 0, 0, 0, 0, 0, 2.0 + index, 1)
        images += f"{index}.png".encode() + b"\0" + struct.pack("<Qddq", 1, 3.0, 4.0, 1)
    (model / "images.bin").write_bytes(images)
    point = struct.pack("<Q3d3BdQ", 1, 0.1, 0.2, 0.3, 200, 100, 50, 0.5, 2)
    point += struct.pack("<4i", 1, 0, 2, 0)
    (model / "points3D.bin").write_bytes(struct.pack("<Q", 1) + point)


def _write_text(model: Path) -> None:
    """Write the same model as text."""
    (model / "cameras.txt").write_text(f"# made\n1 PINHOLE {_SIZE_PX} {_SIZE_PX} 9 9 4 4\n")
    lines = [f"{i + 1} 1 0 0 0 0 0 {2 + i} 1 {i}.png\n3 4 1\n" for i in range(_PHOTOS)]
    (model / "images.txt").write_text("".join(lines))
    (model / "points3D.txt").write_text("1 0.1 0.2 0.3 200 100 50 0.5 1 0 2 0\n")
