"""Time splat PLY reading and writing against the floor.

``python -m recipes.benchmarks.formats.ply_io``

What is measured, warm (the file is in the page cache), medians over repeats that take turns
with the floor's, so that other load meets both
----------------------------------------------------------------------------
* read: ``load_splats`` into contiguous activated arrays, and ``read_splats``, which keeps the
  file's bytes for appending too; floor: one ``numpy.fromfile`` of the same bytes into one array.
* write: ``write_splats`` (atomic, with fsync); floor: one ``numpy.ndarray.tofile`` of the same
  bytes, with an fsync where ours has one. Both are given without fsync too, which is measured by
  making ``os.fsync`` do nothing for the time.
* row writer: one tuple per splat through numpy and ``plyfile``, as the original 3DGS saves.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np
import torch

from gscomplete.splats import Splats, load_splats, read_splats, write_splats
from recipes.entry_point import start


@dataclass(frozen=True)
class Options:
    """Time splat PLY reading and writing."""

    count: int = 1_000_000
    """Splats."""
    degrees: tuple[int, ...] = (0, 3)
    """SH degrees."""
    repeats: int = 5
    """Timed repeats."""
    row_writer_splats: int = 50_000
    """Splats for the row writer, whose time is scaled up; 0 = leave it out."""
    folder: Path | None = None
    """Where the files go; None = a temporary folder."""


def random_splats(count: int, degree: int) -> Splats:
    """Return splats with random values in the usual ranges."""
    generator = torch.Generator().manual_seed(0)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    return Splats(
        normal(count, 3),
        torch.nn.functional.normalize(normal(count, 4), dim=1),
        (normal(count, 3) * 0.5 - 4).exp(),
        torch.sigmoid(normal(count)),
        normal(count, (degree + 1) ** 2, 3) * 0.3,
    )


def medians_s(actions: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Return the median time of every action after one untimed call; they take turns."""
    times: dict[str, list[float]] = {name: [] for name in actions}
    for turn in range(repeats + 1):
        for name, action in actions.items():
            started = time.perf_counter()
            action()
            if turn:
                times[name].append(time.perf_counter() - started)
    return {name: statistics.median(values) for name, values in times.items()}


def write_by_rows(path: Path, splats: Splats) -> None:
    """Write as the original 3DGS does: a list of tuples, then plyfile."""
    from plyfile import PlyData, PlyElement

    values = [splats.means, torch.zeros_like(splats.means), splats.sh[:, 0]]
    values += [splats.sh[:, 1:].transpose(1, 2).flatten(1), splats.opacities.logit()[:, None]]
    values += [splats.scales.log(), splats.quaternions]
    table = torch.cat(values, dim=1).numpy()
    rows = np.empty(len(table), [(f"p{i}", "f4") for i in range(table.shape[1])])
    rows[:] = list(map(tuple, table))
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(path))


def measure(options: Options, degree: int, folder: Path) -> dict[str, float | int]:
    """Measure one SH degree."""
    splats = random_splats(options.count, degree)
    path, raw = folder / "splats.ply", folder / "raw.bin"
    write_splats(path, splats)
    content = np.fromfile(path, np.uint8)
    content.tofile(raw)

    def floor_write() -> None:
        with raw.open("wb") as stream:
            content.tofile(stream)
            stream.flush()
            os.fsync(stream.fileno())

    writes = {"write": lambda: write_splats(path, splats), "tofile": floor_write}
    reads = {
        "load": lambda: load_splats(path),
        "read": lambda: read_splats(path),
        "fromfile": lambda: np.fromfile(raw, np.uint8),
    }
    times = medians_s(reads, options.repeats)
    synced = medians_s(writes, options.repeats)
    times |= {f"{name}_fsync": seconds for name, seconds in synced.items()}
    with mock.patch("os.fsync"):
        times |= medians_s(writes, options.repeats)
    write_s = times["write"]
    row: dict[str, float | int] = {
        "sh_degree": degree,
        "splats": options.count,
        "megabytes": round(content.nbytes / 1e6, 1),
        "load_ratio": round(times["load"] / times["fromfile"], 2),
        "read_ratio": round(times["read"] / times["fromfile"], 2),
        "write_ratio": round(write_s / times["tofile"], 2),
        "write_fsync_ratio": round(times["write_fsync"] / times["tofile_fsync"], 2),
        **{f"{name}_s": round(seconds, 4) for name, seconds in times.items()},
    }
    if options.row_writer_splats:
        few = splats.select(torch.arange(options.row_writer_splats))
        started = time.perf_counter()
        write_by_rows(folder / "rows.ply", few)
        scale = options.count / options.row_writer_splats
        row["row_writer_s"] = round((time.perf_counter() - started) * scale, 2)
        row["faster_than_rows"] = round(row["row_writer_s"] / write_s, 1)
    return row


def main(options: Options) -> None:
    """Run the benchmark and report."""
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        for degree in options.degrees:
            sys.stdout.write(json.dumps(measure(options, degree, Path(name))) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    start(main, Options, __doc__)
