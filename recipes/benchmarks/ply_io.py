"""Time splat PLY reading and writing against the floor: ``python -m recipes.benchmarks.ply_io``.

What is measured, warm (the file is in the page cache), medians over repeats
----------------------------------------------------------------------------
* read: ``read_splats`` into contiguous activated arrays; floor: one ``numpy.fromfile`` of the same
  bytes into one array.
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
import tyro

from gscomplete.splats import Splats, read_splats, write_splats


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


def median_s(action: Callable[[], object], repeats: int) -> float:
    """Return the median time of an action after one untimed call."""
    action()
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        action()
        times.append(time.perf_counter() - started)
    return statistics.median(times)


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

    repeats = options.repeats
    read_s = median_s(lambda: read_splats(path), repeats)
    floor_read_s = median_s(lambda: np.fromfile(raw, np.uint8), repeats)
    synced_s, floor_synced_s = median_s(lambda: write_splats(path, splats), repeats), 0.0
    floor_synced_s = median_s(floor_write, repeats)
    with mock.patch("os.fsync"):
        write_s = median_s(lambda: write_splats(path, splats), repeats)
        floor_write_s = median_s(floor_write, repeats)
    row: dict[str, float | int] = {
        "sh_degree": degree,
        "splats": options.count,
        "megabytes": round(content.nbytes / 1e6, 1),
        "read_s": round(read_s, 4),
        "fromfile_s": round(floor_read_s, 4),
        "read_ratio": round(read_s / floor_read_s, 2),
        "write_s": round(write_s, 4),
        "tofile_s": round(floor_write_s, 4),
        "write_ratio": round(write_s / floor_write_s, 2),
        "write_fsync_s": round(synced_s, 4),
        "tofile_fsync_s": round(floor_synced_s, 4),
        "write_fsync_ratio": round(synced_s / floor_synced_s, 2),
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
    main(tyro.cli(Options))
