"""Splat files: PLY, binary and as text, compressed PLY, .splat, .spz in two versions, .glb."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np


def splat_seeds(folder: Path) -> list[tuple[str, Callable[[Path], object]]]:
    """Write the files; return each with its reader."""
    import gsply

    from gscomplete.splats import write_splats
    from gscomplete.splats.validation import validate_file
    from recipes.benchmarks.ply_io import random_splats
    from splatcomplete_data.formats import write_any_splats

    splats = random_splats(40, 1)
    write_splats(folder / "splats.ply", splats)
    names = ["a.splat", "a.spz", "a.compressed.ply", "a.glb"]
    for name in names:
        write_any_splats(folder / name, splats)
    gsply.write_spz(folder / "four.spz", gsply.read_spz(folder / "a.spz"), version=4)
    _write_text(folder / "text.ply")
    names += ["splats.ply", "four.spz", "text.ply"]
    return [
        *((name, rewritten) for name in names),
        ("splats.ply", validate_file),
        ("text.ply", validate_file),
    ]


def rewritten(path: Path) -> object:
    """Read splats and write what can be drawn of them, which refuses what is not finite."""
    from gscomplete.splats import usable_rows
    from splatcomplete_data.formats import read_any_splats, write_any_splats

    splats = read_any_splats(path).splats
    usable, _ = usable_rows(splats)
    if bool(usable.any()):
        write_any_splats(path.with_name("written.ply"), splats.select(usable))
    return splats.select(usable)


def _write_text(path: Path) -> None:
    """Write splats as text, row by row."""
    names = [*"xyz", *(f"f_dc_{i}" for i in range(3)), "opacity"]
    names += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
    rows = np.random.default_rng(3).normal(size=(20, len(names)))
    head = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 20\n"
    head += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    body = "\n".join(" ".join(f"{value:.4f}" for value in row) for row in rows)
    path.write_text(f"{head}{body}\n")
