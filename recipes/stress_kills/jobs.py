"""Jobs that are killed: small ones, each with the files that must not differ in the end."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch

from gscomplete.folders import RUN_FILE
from gscomplete.splats import Splats, read_splats, write_splats

_SAMPLE = Path(__file__).resolve().parents[1] / "demo/partial.ply"
_RUN_RESULTS = ("completed.ply", "preview.png", "turntable.webp")


@dataclass(frozen=True)
class Job:
    """A command that can be started again after whatever stopped it."""

    name: str
    begin: Callable[[Path], Sequence[object]]
    """Words of the command that works in a folder."""
    results: tuple[str, ...]
    """Files below that folder that must not differ, and must never be there in part."""
    proceed: Callable[[Path], Sequence[object]] | None = None
    """Words of the command that goes on once a folder has ``begun_by``; None = the same."""
    begun_by: str = ""
    """File below the folder that says that a run is to be resumed."""
    stopped_codes: tuple[int, ...] = field(default=(2,))
    """Exit codes for a full disk."""

    def command(self, out: Path) -> list[str]:
        """Return the command that starts the job or goes on with it."""
        is_begun = self.proceed is not None and (out / self.begun_by).exists()
        words = self.proceed(out) if is_begun and self.proceed is not None else self.begin(out)
        return [str(word) for word in words]


def small_jobs(folder: Path) -> list[Job]:
    """Write the inputs of a completion, a build and a batch; return the jobs.

    Args:
        folder: for the inputs.
    """
    return [_completion(folder), _build(folder), _batch(folder)]


def _completion(folder: Path) -> Job:
    """Return a completion with optimiser steps and a checkpoint after every second one."""
    path = folder / "part.ply"
    write_splats(path, _sample())
    words = [sys.executable, "-m", "gscomplete.cli", "complete", path, "--prompt", "a red mug"]
    words += ["--preset", "reconstruct", "--steps", 12, "--checkpoint-every", 2]
    return Job(
        "complete",
        lambda out: [*words, "--out", out],
        _RUN_RESULTS,
        lambda out: [*words, "--out", out, "--resume"],
        RUN_FILE,
    )


def _build(folder: Path) -> Job:
    """Return a build of four objects from meshes."""
    import trimesh

    data = folder / "data"
    data.mkdir()
    trimesh.creation.box((1, 1, 1)).export(data / "box.ply")
    trimesh.creation.icosphere(subdivisions=2).export(data / "ball.obj")
    rows = [
        {
            "id": f"{file[:4]}{angle}",
            "command": "mesh",
            "file": file,
            "count": 3000,
            "cut": [f"plane:{angle}"],
            "prompt": "a thing",
        }
        for file in ("box.ply", "ball.obj")
        for angle in (0, 90)
    ]
    recipe = {"schema": "splatcomplete.recipe", "version": 1, "name": "kills", "objects": rows}
    (folder / "recipe.yaml").write_text(json.dumps(recipe))
    words = [sys.executable, "-m", "splatcomplete_data.cli", "build", folder / "recipe.yaml"]
    words += ["--data", data, "--workers", 1]
    files = ("complete.ply", "partial.ply", "preview.png", "object.json")
    results = tuple(f"{row['id']}/{file}" for row in rows for file in files)
    return Job("build", lambda out: [*words, "--out", out], results, stopped_codes=(1, 2))


def _batch(folder: Path) -> Job:
    """Return a batch of three small parts."""
    splats = _sample()
    order = splats.means[:, 2].argsort()
    names = ("low", "middle", "high")
    for name, rows in zip(names, order.chunk(len(names)), strict=True):
        write_splats(folder / f"{name}.ply", splats.select(rows.sort().values))
    manifest = folder / "objects.jsonl"
    lines = [json.dumps({"partial": f"{name}.ply", "prompt": "a red mug"}) for name in names]
    manifest.write_text("\n".join(lines))
    words = [sys.executable, "-m", "gscomplete.cli", "batch", manifest, "--preset", "fast"]
    words += ["--workers", 1, "--threads", 1]
    results = tuple(f"{name}/{file}" for name in names for file in _RUN_RESULTS)
    return Job("batch", lambda out: [*words, "--out", out], results, stopped_codes=(1, 2))


def _sample() -> Splats:
    """Return every fourth splat of the demo's part, widened to match."""
    splats = read_splats(_SAMPLE).splats
    chosen = splats.select(torch.arange(0, len(splats), 4))
    return Splats(
        **{name: 2 * value if name == "scales" else value for name, value in chosen.fields()}
    )
