"""Splat files: PLY (also as text), compressed PLY, .splat, two .spz, .glb, .sog, .ksplat."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from gscomplete.splats import Splats


def splat_seeds(folder: Path) -> list[tuple[str, Callable[[Path], object]]]:
    """Write the files; return each with its reader."""
    import gsply

    from gscomplete.splats import write_splats
    from gscomplete.splats.formats.any_file import write_any_splats
    from gscomplete.splats.validation import validate_file
    from recipes.benchmarks.formats.ply_io import random_splats

    splats = random_splats(40, 1)
    write_splats(folder / "splats.ply", splats)
    names = ["a.splat", "a.spz", "a.compressed.ply", "a.glb", "a.sog"]
    for name in names:
        write_any_splats(folder / name, splats)
    gsply.write_spz(folder / "four.spz", gsply.read_spz(folder / "a.spz"), version=4)
    _write_text(folder / "text.ply")
    _write_ksplat(folder / "a.ksplat", splats)
    names += ["splats.ply", "four.spz", "text.ply", "a.ksplat"]
    return [
        *((name, rewritten) for name in names),
        ("splats.ply", validate_file),
        ("text.ply", validate_file),
    ]


def rewritten(path: Path) -> object:
    """Read splats and write what can be drawn of them, which refuses what is not finite."""
    from gscomplete.splats import usable_rows
    from gscomplete.splats.formats.any_file import read_any_splats, write_any_splats

    splats = read_any_splats(path).splats
    usable, _ = usable_rows(splats)
    if bool(usable.any()):
        write_any_splats(path.with_name("written.ply"), splats.select(usable))
    return splats.select(usable)


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


def _write_text(path: Path) -> None:
    """Write splats as text, row by row."""
    names = [*"xyz", *(f"f_dc_{i}" for i in range(3)), "opacity"]
    names += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
    rows = np.random.default_rng(3).normal(size=(20, len(names)))
    head = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 20\n"
    head += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    body = "\n".join(" ".join(f"{value:.4f}" for value in row) for row in rows)
    path.write_text(f"{head}{body}\n")
