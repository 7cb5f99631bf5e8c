"""Feed the readers mutated files: ``python -m recipes.stress_readers [--count 2000] [--seed 0]``.

A small valid file of every kind is mutated (bytes changed, runs removed, doubled, swapped or
overwritten, the end cut off) and read. Anything but a result or a ``UserError`` within the time
limit is a failure, and the file that caused it is kept. Which mutation is number n depends on
(seed, n) alone.
"""

from __future__ import annotations

import collections
import json
import logging
import resource
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np

from gscomplete.errors import UserError
from recipes.entry_point import start

Reader = Callable[[Path], object]


@dataclass(frozen=True)
class Options:
    """Feed the readers mutated files."""

    count: int = 2000
    """Mutated files."""
    seed: int = 0
    """Seed of the mutations."""
    limit_s: int = 20
    """Longest time for one file."""
    limit_gb: float = 8.0
    """Most address space; a reader that wants more for a small file fails."""
    keep: Path = Path("stress_failures")
    """Folder for files that made a reader fail; not created when there is none."""


def seed_files(folder: Path) -> list[tuple[Path, Reader]]:
    """Write a valid file of every kind; return each with its reader."""
    import trimesh
    from PIL import Image

    from gscomplete.splats import write_splats
    from gscomplete.splats.validation import validate_file
    from recipes.benchmarks.ply_io import random_splats
    from splatcomplete_data.dataset.recipe import read_recipe
    from splatcomplete_data.formats import read_any_splats, write_any_splats
    from splatcomplete_data.mesh.files.load import load_mesh
    from splatcomplete_data.objects import read_record
    from splatcomplete_data.scan.read import read_scan
    from splatcomplete_data.singleview.depth_file import read_depth

    found: list[tuple[Path, Reader]] = []
    splats = random_splats(40, 1)
    write_splats(folder / "splats.ply", splats)
    found += [(folder / "splats.ply", read_any_splats), (folder / "splats.ply", validate_file)]
    for name in ("a.splat", "a.spz", "a.compressed.ply"):
        write_any_splats(folder / name, splats)
        found.append((folder / name, read_any_splats))
    box = trimesh.creation.icosphere(subdivisions=1)
    image = Image.fromarray(np.arange(192, dtype=np.uint8).reshape(8, 8, 3))
    uv = box.vertices[:, :2] * 0.5 + 0.5
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=image)
    box.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    for name in ("m.glb", "m.obj", "m.ply", "m.stl", "m.off", "m.dae"):
        box.export(folder / name)
        found.append((folder / name, load_mesh))
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
    return found


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


def mutate(data: bytes, seed: int, number: int) -> bytes:
    """Return a damaged copy of a file's bytes."""
    rng = np.random.default_rng((seed, number))
    raw = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        if not raw:
            break
        kind = int(rng.integers(6))
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


def try_reader(reader: Reader, path: Path, limit_s: int) -> str:
    """Read a file; return ``read``, ``refused``, or what went wrong."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"longer than {limit_s} s")

    signal.signal(signal.SIGALRM, stop)
    signal.alarm(limit_s)
    try:
        reader(path)
    except UserError:
        return "refused"
    except BaseException as error:  # anything else is what is looked for
        return f"{type(error).__name__}: {error}"[:200]
    finally:
        signal.alarm(0)
    return "read"


def main(options: Options) -> int:
    """Run all mutations and report; return 1 if any made a reader fail."""
    limit = int(options.limit_gb * 1e9)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    counts: collections.Counter[str] = collections.Counter()
    failures = []
    slowest, slowest_name = 0.0, ""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "seeds").mkdir()
        (folder / "mutated").mkdir()
        seeds = seed_files(folder / "seeds")
        for path, reader in seeds:
            answer = try_reader(reader, path, 60)
            if answer != "read":
                raise UserError(f"{path.name}: the seed itself gives: {answer}")
        for number in range(options.count):
            path, reader = seeds[number % len(seeds)]
            damaged = folder / "mutated" / path.name
            damaged.write_bytes(mutate(path.read_bytes(), options.seed, number))
            started = time.perf_counter()
            answer = try_reader(reader, damaged, options.limit_s)
            seconds = time.perf_counter() - started
            if seconds > slowest:
                slowest, slowest_name = seconds, f"{number} {path.name}"
            counts[answer if answer in ("read", "refused") else "failed"] += 1
            if answer not in ("read", "refused"):
                failures.append({"number": number, "file": path.name, "answer": answer})
                options.keep.mkdir(parents=True, exist_ok=True)
                shutil.copy(damaged, options.keep / f"{number}_{path.name}")
    for failure in failures:
        sys.stdout.write(json.dumps(failure) + "\n")
    sys.stdout.write(
        json.dumps({**counts, "slowest_s": round(slowest, 2), "slowest": slowest_name}) + "\n"
    )
    return 1 if failures else 0


if __name__ == "__main__":
    start(main, Options, __doc__)
