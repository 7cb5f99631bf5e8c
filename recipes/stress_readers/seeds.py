"""A small valid file of every kind that is read, each with its reader."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from gscomplete.splats import Splats

Reader = Callable[[Path], object]


def seed_files(folder: Path) -> list[tuple[Path, Reader]]:
    """Write a valid file of every kind; return each with its reader."""
    import trimesh
    from PIL import Image

    from gscomplete.splats import write_splats
    from gscomplete.splats.formats.any_file import write_any_splats
    from gscomplete.splats.validation import validate_file
    from recipes.benchmarks.ply_io import random_splats
    from splatcomplete_data.dataset.recipe import read_recipe
    from splatcomplete_data.objects import read_record
    from splatcomplete_data.scan.read import read_scan
    from splatcomplete_data.singleview.depth_file import read_depth

    found: list[tuple[Path, Reader]] = []
    splats = random_splats(40, 1)
    write_splats(folder / "splats.ply", splats)
    found += [(folder / "splats.ply", _rewrite), (folder / "splats.ply", validate_file)]
    for name in ("a.splat", "a.spz", "a.compressed.ply", "a.sog", "splats.glb"):
        write_any_splats(folder / name, splats)
        found.append((folder / name, _rewrite))
    _write_ksplat(folder / "a.ksplat", splats)
    found.append((folder / "a.ksplat", _rewrite))
    box = trimesh.creation.icosphere(subdivisions=1)
    image = Image.fromarray(np.arange(192, dtype=np.uint8).reshape(8, 8, 3))
    uv = box.vertices[:, :2] * 0.5 + 0.5
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=image)
    box.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    for name in ("m.glb", "m.obj", "m.ply", "m.stl", "m.off", "m.dae"):
        box.export(folder / name)
        found.append((folder / name, _convert))
    points = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    header = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 50\nHEIGHT 1\nPOINTS 50\nDATA binary\n"
    (folder / "s.pcd").write_bytes(header.encode() + points.tobytes())
    np.savetxt(folder / "s.xyz", points)
    trimesh.PointCloud(points).export(folder / "s.ply")
    found += [(folder / name, read_scan) for name in ("s.pcd", "s.xyz", "s.ply")]
    found += _las(folder, points, read_scan)
    depth = np.full((12, 16), 1500, np.uint16)
    Image.fromarray(depth).save(folder / "d.png")
    np.save(folder / "d.npy", depth)
    np.savez(folder / "d.npz", depth=depth[None])
    Image.fromarray(depth.astype(np.float32)).save(folder / "d.tif")
    found += [(folder / name, read_depth) for name in ("d.png", "d.npy", "d.npz", "d.tif")]
    (folder / "r.yaml").write_text(
        "schema: splatcomplete.recipe\nversion: 1\nname: x\nobjects:\n"
        "  - {id: a, command: mesh, file: m.obj, count: 100, cut: ['plane:90'], prompt: p}\n"
    )
    found.append((folder / "r.yaml", read_recipe))
    found += _record(folder, lambda path: read_record(path.parent))
    found += _captures(folder, splats)
    found += _runs(folder)
    return found


def _write_ksplat(path: Path, splats: Splats) -> None:
    """Write a .ksplat of one section whose rows lie in one bucket, without harmonics."""
    count = len(splats)
    head, section = np.zeros(4096, np.uint8), np.zeros(1024, np.uint8)
    head[1] = 1
    head.view("<u4")[1:5] = 1, 1, count, count
    head.view("<u2")[10] = 1
    section.view("<u4")[:4] = count, count, count, 1
    section.view("<f4")[4] = 5.0
    section.view("<u2")[10] = 12
    section.view("<u4")[8] = 1
    steps = (splats.means.numpy() / (2.5 / 32767) + 32767).clip(0, 65535)
    rows = np.concatenate(
        [
            steps.astype("<u2").view(np.uint8),
            splats.scales.numpy().astype("<f2").view(np.uint8),
            splats.quaternions.numpy().astype("<f2").view(np.uint8),
            np.full((count, 4), 128, np.uint8),
        ],
        axis=1,
    )
    path.write_bytes(head.tobytes() + section.tobytes() + bytes(12) + rows.tobytes())


def _las(folder: Path, points: np.ndarray, reader: Reader) -> list[tuple[Path, Reader]]:
    """Write LAS and LAZ files."""
    import laspy

    las = laspy.create(point_format=2, file_version="1.2")
    las.header.scales = np.full(3, 0.001)
    las.x, las.y, las.z = points.T
    for name in ("s.las", "s.laz"):
        las.write(str(folder / name))
    return [(folder / name, reader) for name in ("s.las", "s.laz")]


def _record(folder: Path, reader: Reader) -> list[tuple[Path, Reader]]:
    """Write an object.json."""
    from gscomplete.util import jsonio
    from gscomplete.views import ObjectFrame, ViewDistribution
    from splatcomplete_data.objects import ObjectRecord, SourceRecord

    frame = ObjectFrame("Z", (0.0, 0.0, 0.0), 1.0)
    record = ObjectRecord(
        "a", "mesh", "a box", SourceRecord("m.obj"), frame, "truth", ViewDistribution(0.0, 10.0)
    )
    jsonio.write_json(folder / "object.json", record.to_json())
    return [(folder / "object.json", reader)]


def _captures(folder: Path, splats: Splats) -> list[tuple[Path, Reader]]:
    """Write a transforms.json, a COLMAP model, masks, ASCII splats, SPZ 4 and what else they need.

    A reader is given a file of the folder that the seeds lie in, or of one beside it.
    """
    import gsply
    from PIL import Image

    from splatcomplete_data.multiview.photos.colmap_model import read_points
    from splatcomplete_data.multiview.photos.transforms_json import read_transforms
    from splatcomplete_data.pictures import read_mask

    photos = folder.parent / "photos"
    photos.mkdir()
    rng = np.random.default_rng(3)
    for index in range(4):
        Image.fromarray(rng.integers(0, 255, (8, 8, 3), np.uint8)).save(photos / f"{index}.png")
    turn = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]])
    matrices = [np.linalg.matrix_power(turn, index).tolist() for index in range(4)]
    frames = [
        {"file_path": f"../photos/{index}.png", "transform_matrix": matrix}
        for index, matrix in enumerate(matrices)
    ]
    (folder / "transforms.json").write_text(
        json.dumps({"camera_angle_x": 0.8, "w": 8, "h": 8, "k1": 0.01, "frames": frames})
    )
    Image.fromarray(rng.integers(0, 2, (8, 8), np.uint8) * 255).save(folder / "mask.png")
    point = np.array([1], np.uint64).tobytes() + np.array([0.1, 0.2, 0.3]).tobytes()
    point += bytes([200, 100, 50]) + np.array([0.5]).tobytes() + np.array([2], np.uint64).tobytes()
    point += np.array([1, 0, 2, 5], np.int32).tobytes()
    (folder / "points3D.bin").write_bytes(np.array([1], np.uint64).tobytes() + point)
    gsply.write_spz(folder / "four.spz", gsply.read_spz(folder / "a.spz"), version=4)
    names = [*"xyz", *(f"f_dc_{i}" for i in range(3)), "opacity"]
    names += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
    rows = rng.normal(size=(20, len(names)))
    head = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 20\n"
    head += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    body = "\n".join(" ".join(f"{value:.4f}" for value in row) for row in rows)
    (folder / "ascii.ply").write_text(f"{head}{body}\n")
    return [
        (folder / "transforms.json", lambda path: read_transforms(path, None, photos)),
        (folder / "mask.png", read_mask),
        (folder / "points3D.bin", lambda path: read_points(path.parent)),
        (folder / "four.spz", _rewrite),
        (folder / "ascii.ply", _rewrite),
    ]


def _runs(folder: Path) -> list[tuple[Path, Reader]]:
    """Write a run.json, a checkpoint and the weights of a prior."""
    import torch
    from safetensors.torch import save_file

    from gscomplete.fitting.checkpoint import FILE_NAME, check_fits, load_checkpoint
    from gscomplete.fitting.step_loop import require_same_identity
    from gscomplete.folders import RUN_FILE, read_run_folder
    from gscomplete.priors.mvdream.tensor_files import TensorFile
    from gscomplete.util.jsonio import write_json
    from gscomplete.views import ObjectFrame, ViewDistribution

    identity = {
        "prompt": "a mug",
        "frame": ObjectFrame("Z", (0.0, 0.0, 0.0), 1.0).to_json(),
        "views": ViewDistribution(0.0, 10.0).to_json(),
        "settings": {"seed": 0},
    }
    run = {"schema": "gscomplete.run", "input": {"path": "p.ply", "splats": 3}}
    write_json(folder / RUN_FILE, {**run, "identity": identity})
    fresh = {"step": torch.tensor(0), "value.means": torch.zeros(4, 3)}
    state = {**fresh, "step": torch.tensor(3), "adam.means.step": torch.tensor(3.0)}
    state |= {f"adam.means.{key}": torch.ones(4, 3) for key in ("exp_avg", "exp_avg_sq")}
    save_file(state, folder / FILE_NAME)
    save_file({"a.weight": torch.ones(3, 4), "b": torch.ones(2)}, folder / "w.safetensors")
    torch.save({"a.weight": torch.ones(3, 4), "b": torch.ones(2)}, folder / "w.pt")

    def checkpoint(path: Path) -> None:
        found = load_checkpoint(path.parent)
        if found is not None:
            check_fits(path, found, fresh, 5)

    def resume(path: Path) -> None:
        read_run_folder(path.parent)
        require_same_identity(path, identity)

    def tensors(path: Path) -> None:
        files = TensorFile(path)
        for name in ("a.weight", "b"):
            files.get(name)

    return [
        (folder / RUN_FILE, resume),
        (folder / FILE_NAME, checkpoint),
        (folder / "w.safetensors", tensors),
        (folder / "w.pt", tensors),
        *_weights(folder),
    ]


def _weights(folder: Path) -> list[tuple[Path, Reader]]:
    """Write the weights of a tiny embedded prior."""
    from gscomplete.priors.base import PriorViews
    from gscomplete.priors.embedded.model import FourViewDenoiser, ModelConfig
    from gscomplete.priors.embedded.weights import (
        CONFIG_FILE,
        FORMAT_VERSION,
        WEIGHTS_FILE,
        PriorConfig,
        TrainingRecord,
        load_weights,
        save_weights,
    )

    size = ModelConfig(
        resolution_px=16,
        widths=(16, 16, 32),
        blocks=(1, 1, 1),
        transformers=(1, 1),
        head_width=16,
        groups=4,
        embedding=32,
        text_width=16,
        text_length=6,
        vocabulary_size=6,
    )
    views = PriorViews(40.0, (1.35, 1.9), (-10.0, 45.0), size.resolution_px)
    record = TrainingRecord(steps=1, sets=1, hours=0.0, machine="", seed=0)
    words = ("a", "b", "c", "d")
    home = folder.parent / "weights"
    home.mkdir()
    config = PriorConfig(FORMAT_VERSION, size, views, words, "int8", record)
    save_weights(home, FourViewDenoiser(size).state_dict(), config)
    for name in (CONFIG_FILE, WEIGHTS_FILE):
        shutil.copy(home / name, folder / name)

    def read(path: Path) -> None:
        for name in {CONFIG_FILE, WEIGHTS_FILE} - {path.name}:
            shutil.copy(home / name, path.parent / name)
        load_weights(path.parent)

    return [(folder / name, read) for name in (CONFIG_FILE, WEIGHTS_FILE)]


def _rewrite(path: Path) -> None:
    """Read splats and write them, which refuses what is not finite."""
    from gscomplete.splats import usable_rows
    from gscomplete.splats.formats.any_file import read_any_splats, write_any_splats

    splats = read_any_splats(path).splats
    usable, _ = usable_rows(splats)
    if bool(usable.any()):
        write_any_splats(path.with_name("written.ply"), splats.select(usable))


def _convert(path: Path) -> None:
    """Read a mesh and turn it into splats, which must be finite."""
    from gscomplete.splats import usable_rows
    from splatcomplete_data.mesh.convert import convert_mesh
    from splatcomplete_data.mesh.files.load import load_mesh

    usable, reasons = usable_rows(convert_mesh(load_mesh(path), 200).splats)
    if not bool(usable.all()):
        raise ValueError(f"splats that are not usable: {reasons}")
