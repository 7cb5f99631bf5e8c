"""Scans: PCD in its three codings, text, PLY, LAS and LAZ."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from gscomplete.util.arrays import Float32Array

_COUNT = 50


def scan_seeds(folder: Path) -> list[tuple[str, Callable[[Path], object]]]:
    """Write the files; return each with its reader."""
    import laspy
    import trimesh

    from splatcomplete_data.scan.read import read_scan

    points = np.random.default_rng(0).normal(size=(_COUNT, 3)).astype(np.float32)
    _write_pcd(folder, points)
    np.savetxt(folder / "s.xyz", points)
    (folder / "s.csv").write_text(
        "x,y,z,r,g,b\n" + "\n".join(f"{x:.3f},{y:.3f},{z:.3f},9,20,255" for x, y, z in points)
    )
    trimesh.PointCloud(points).export(folder / "s.ply")
    las = laspy.create(point_format=2, file_version="1.2")
    las.header.scales = np.full(3, 0.001)
    las.x, las.y, las.z = points.T
    for name in ("s.las", "s.laz"):
        las.write(str(folder / name))
    return [(path.name, read_scan) for path in sorted(folder.iterdir())]


def _write_pcd(folder: Path, points: Float32Array) -> None:  # [N, 3]
    """Write the points as text, as bytes by point, and as packed bytes by field."""
    head = f"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {_COUNT}\nHEIGHT 1\nPOINTS {_COUNT}\nDATA "
    text = "\n".join(" ".join(f"{value:.4f}" for value in point) for point in points)
    (folder / "text.pcd").write_text(f"{head}ascii\n{text}\n")
    (folder / "s.pcd").write_bytes(f"{head}binary\n".encode() + points.tobytes())
    raw, packed = np.ascontiguousarray(points.T).tobytes(), b""
    for start in range(0, len(raw), 32):  # LZF that only copies: a length less one, then the bytes
        part = raw[start : start + 32]
        packed += bytes([len(part) - 1]) + part
    sizes = np.array([len(packed), len(raw)], "<u4").tobytes()
    (folder / "packed.pcd").write_bytes(f"{head}binary_compressed\n".encode() + sizes + packed)
