"""Small made-up captures: photos on disk with every form of poses."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from gscomplete.render import render
from gscomplete.splats import Splats
from gscomplete.views import Cameras, orbit_cameras
from tests.builders import objects
from tests.builders.objects import round_splats

SIZE_PX = 32
FOV_DEG = 50.0


def cameras(count: int = 8, size_px: int = SIZE_PX) -> Cameras:
    """Cameras on a ring, looking at the origin."""
    azimuths = torch.arange(count, dtype=torch.float64) * (360.0 / count)
    elevations = torch.full((count,), 20.0, dtype=torch.float64)
    return orbit_cameras(azimuths, elevations, radius=3.0, fov_deg=FOV_DEG, size_px=size_px)


def ball(count: int = 400) -> Splats:
    """Return the round splats that photos are taken of: radius 0.6, about the origin."""
    normals = objects.ball(count, 1.0).means
    return round_splats(0.6 * normals, scale=0.06, opacity=0.95, color=0.5 + 0.4 * normals)


def photos(folder: Path, views: Cameras, *, alpha: bool = False) -> list[str]:
    """Write photos of the ball; return their names."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn = render(ball(), views)
    names = []
    for index in range(len(views)):
        color = drawn.color[index].clamp(0, 1)
        pixels = (color * 255).round().to(torch.uint8).numpy()
        if alpha:
            shown = (drawn.alpha[index].clamp(0, 1) * 255).round().to(torch.uint8).numpy()
            pixels = np.dstack([pixels, shown])
        names.append(f"photo_{index:02}.png")
        Image.fromarray(pixels).save(folder / names[-1])
    return names


def transforms_file(path: Path, views: Cameras, names: list[str], **extra: object) -> None:
    """Write a transforms.json for photos in ``images`` beside it."""
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    frames = [
        {
            "file_path": f"images/{name}",
            "transform_matrix": (
                np.linalg.inv(views.camera_from_world[index].double().numpy()) @ flip
            ).tolist(),
        }
        for index, name in enumerate(names)
    ]
    data = {
        "fl_x": float(views.focal_px[0, 0]),
        "fl_y": float(views.focal_px[0, 1]),
        "cx": views.width / 2,
        "cy": views.height / 2,
        "w": views.width,
        "h": views.height,
        "frames": frames,
    }
    path.write_text(json.dumps({**data, **extra}))


def transforms_capture(folder: Path, count: int = 8, *, alpha: bool = False) -> Path:
    """Write a whole capture with a transforms.json; return its folder."""
    views = cameras(count)
    names = photos(folder / "images", views, alpha=alpha)
    transforms_file(folder / "transforms.json", views, names)
    return folder


def nested_capture(folder: Path) -> Path:
    """Write a capture whose photos have the same names in two folders; return transforms.json."""
    path = transforms_capture(folder) / "transforms.json"
    data = json.loads(path.read_text())
    for index, frame in enumerate(data["frames"]):
        photo = folder / "images" / ("left", "right")[index % 2] / f"{index // 2:04}.png"
        photo.parent.mkdir(exist_ok=True)
        (folder / frame["file_path"]).rename(photo)
        frame["file_path"] = photo.relative_to(folder).as_posix()
    path.write_text(json.dumps(data))
    return path


def huge_picture(path: Path) -> None:
    """Write the head of a PNG with more pixels than any photo has."""
    data = b"\x89PNG\r\n\x1a\n"
    for name, content in (
        (b"IHDR", struct.pack(">IIBBBBB", 10**6, 10**6, 8, 2, 0, 0, 0)),
        (b"IDAT", b""),
    ):
        data += struct.pack(">I", len(content)) + name + content
        data += struct.pack(">I", zlib.crc32(name + content))
    path.write_bytes(data)


def quaternion_of(rotation: np.ndarray) -> np.ndarray:
    """Quaternion wxyz by the eigenvector that the rotation leaves, independent of the code."""
    k = np.empty((4, 4))
    m = rotation
    k[0] = [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]
    k[1] = [k[0, 1], m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2]]
    k[2] = [k[0, 2], k[1, 2], m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1]]
    k[3] = [k[0, 3], k[1, 3], k[2, 3], m[2, 2] - m[0, 0] - m[1, 1]]
    return np.linalg.eigh(k)[1][:, 3]


def colmap_model(
    model: Path, views: Cameras, names: list[str], *, text: bool, camera: tuple | None = None
) -> None:
    """Write cameras, images and three points as COLMAP does.

    Args:
        model: the folder.
        views: poses.
        names: of the photos.
        text: .txt files, else .bin.
        camera: (model name, model id, width, height, numbers); None = PINHOLE of the views.
    """
    model.mkdir(parents=True, exist_ok=True)
    focal = [float(f) for f in views.focal_px[0]]
    pinhole = ("PINHOLE", 1, views.width, views.height, [*focal, views.width / 2, views.height / 2])
    name, number, width, height, numbers = camera or pinhole
    poses = views.camera_from_world.double().numpy()
    points = [(0.1 * i, 0.2, 0.3, 10 * i, 20, 255) for i in range(3)]
    if text:
        row = " ".join(str(value) for value in numbers)
        (model / "cameras.txt").write_text(f"# comment\n1 {name} {width} {height} {row}\n")
        lines = ["# comment"]
        for index, photo in enumerate(names):
            q, t = quaternion_of(poses[index, :3, :3]), poses[index, :3, 3]
            values = " ".join(repr(float(v)) for v in (*q, *t))
            lines += [f"{index + 1} {values} 1 {photo}", "" if index % 2 else "1.0 2.0 -1"]
        (model / "images.txt").write_text("\n".join(lines) + "\n")
        rows = [f"{i} " + " ".join(map(str, p)) + " 0.5 1 1 2 2" for i, p in enumerate(points)]
        (model / "points3D.txt").write_text("\n".join(rows) + "\n")
        return
    data = struct.pack("<QiiQQ", 1, 1, number, width, height)
    (model / "cameras.bin").write_bytes(data + struct.pack(f"<{len(numbers)}d", *numbers))
    data = struct.pack("<Q", len(names))
    for index, photo in enumerate(names):
        q, t = quaternion_of(poses[index, :3, :3]), poses[index, :3, 3]
        data += struct.pack("<i7di", index + 1, *q, *t, 1) + photo.encode() + b"\0"
        data += struct.pack("<Q", 2) + struct.pack("<ddqddq", 1, 2, -1, 3, 4, 1)
    (model / "images.bin").write_bytes(data)
    data = struct.pack("<Q", len(points))
    for index, (x, y, z, r, g, b) in enumerate(points):
        data += struct.pack("<Q3d3BdQ", index, x, y, z, r, g, b, 0.5, 2) + struct.pack(
            "<4i", *[1] * 4
        )
    (model / "points3D.bin").write_bytes(data)
