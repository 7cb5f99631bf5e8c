"""Meshes with a texture: GLB, glTF with side files, OBJ with its material, PLY, STL, OFF, DAE."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np


def mesh_seeds(folder: Path) -> list[tuple[str, Callable[[Path], object]]]:
    """Write the files; return each with its reader."""
    import trimesh
    from PIL import Image

    ball = trimesh.creation.icosphere(subdivisions=1)
    image = Image.fromarray(np.arange(192, dtype=np.uint8).reshape(8, 8, 3))
    uv = ball.vertices[:, :2] * 0.5 + 0.5
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=image)
    ball.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    names = ["m.glb", "m.obj", "m.ply", "m.stl", "m.off", "m.dae"]
    for name in names:
        ball.export(folder / name)
    for name, data in ball.export(file_type="gltf").items():
        (folder / name).write_bytes(data)
    seeds: list[tuple[str, Callable[[Path], object]]] = [(name, _converted) for name in names]
    seeds.append(("model.gltf", _converted))
    for path in sorted(folder.iterdir()):
        if path.suffix in (".bin", ".png"):
            seeds.append((path.name, lambda damaged: _converted(damaged.with_name("model.gltf"))))
        elif path.suffix == ".mtl":
            seeds.append((path.name, lambda damaged: _converted(damaged.with_name("m.obj"))))
    return seeds


def _converted(path: Path) -> object:
    """Read a mesh and turn it into splats."""
    from splatcomplete_data.mesh.convert import convert_mesh
    from splatcomplete_data.mesh.files.load import load_mesh

    return convert_mesh(load_mesh(path), 200).splats
