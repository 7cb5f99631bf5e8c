"""Enter other systems' results: ``python -m recipes.baselines.enter SYSTEM --dataset DIR ...``.

Every object of the dataset for which ``--results`` holds a file ``ID.glb``, ``.obj``, ``.ply``,
``.splat`` or ``.spz`` (or a folder ``ID`` with one such file) gets ``OUT/ID.ply``: converted to
splats and aligned to P, ready for ``gscomplete evaluate --dataset DIR --runs SYSTEM=OUT`` and
``gscomplete report``. ``OUT/alignment.json`` says where each was found and what is doubtful;
``--report`` measures and writes the page at once.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from gscomplete.errors import UserError
from gscomplete.evaluate.align import AlignmentSettings, align_splats
from gscomplete.evaluate.subject import objects_of
from gscomplete.splats import Splats, read_splats, write_splats
from gscomplete.splats.formats.any_file import read_any_splats
from gscomplete.splats.ply import PlyError
from gscomplete.splats.transform import transform_splats
from gscomplete.util import jsonio
from recipes.baselines.registry import SYSTEMS
from recipes.entry_point import start
from splatcomplete_data.mesh.convert import convert_mesh
from splatcomplete_data.mesh.files.load import load_mesh

_MESHES, _SPLATS = (".glb", ".gltf", ".obj", ".ply", ".stl"), (".ply", ".splat", ".spz")
ALIGNMENT_FILE = "alignment.json"


@dataclass(frozen=True)
class Options:
    """Convert and align the results of another system."""

    system: Annotated[str, tyro.conf.Positional]
    """Name in the registry; ``other`` for one that is not listed."""
    dataset: Path
    """Folder of object folders."""
    results: Path
    """Folder of the system's files, named after the objects."""
    out: Path
    """Folder for ID.ply; what is there already is kept."""
    count: int = 60_000
    """Splats that a mesh becomes."""
    rotations: int = 1000
    """Rotations that the alignment tries."""
    report: Path | None = None
    """Measure all that is in OUT and write this HTML page."""


def find_result(results: Path, object_id: str) -> Path | None:
    """Return a system's file of an object; None = there is none.

    Raises:
        UserError: there are several.
    """
    kinds = {*_MESHES, *_SPLATS}
    places = (*results.glob(f"{object_id}.*"), *(results / object_id).glob("*"))
    found = sorted(path for path in places if path.suffix.lower() in kinds)
    if len(found) > 1:
        raise UserError(f"{found[0]}: expected one result of {object_id}, found {len(found)}")
    return found[0] if found else None


def read_result(path: Path, count: int) -> Splats:
    """Read a result as splats: splat files as they are, meshes covered with flat splats.

    Raises:
        UserError: it is neither, or damaged.
    """
    if path.suffix.lower() in _SPLATS:
        try:
            return read_any_splats(path).splats.with_sh_degree(0)
        except PlyError:
            pass  # a PLY that holds a mesh
    return convert_mesh(load_mesh(path), count).splats


def enter(options: Options) -> dict[str, Any]:
    """Convert and align what there is; return what ``alignment.json`` says.

    Raises:
        UserError: the system is not registered, or there is no result at all.
    """
    if options.system not in SYSTEMS:
        known = ", ".join(SYSTEMS)
        raise UserError(f"SYSTEM: expected one of {known}, found {options.system!r}")
    record = options.out / ALIGNMENT_FILE
    done: dict[str, Any] = jsonio.read_json(record) if record.is_file() else {}
    options.out.mkdir(parents=True, exist_ok=True)
    for known_object in objects_of(options.dataset):
        path = find_result(options.results, known_object.id)
        target = options.out / f"{known_object.id}.ply"
        if path is None or target.is_file():
            continue
        splats = read_result(path, options.count)
        partial = read_splats(known_object.partial).splats
        found = align_splats(splats, partial, AlignmentSettings(options.rotations))
        write_splats(target, transform_splats(splats, found.target_from_result))
        done[known_object.id] = {
            "system": options.system,
            "file": path.name,
            "file_from_result": found.target_from_result.to_json(),
            "residual": found.residual,
            "runner_up": found.runner_up,
            "warning": found.warning(),
        }
        jsonio.write_json(record, done)
        warning = f"; {found.warning()}" if found.warning() else ""
        sys.stdout.write(f"{known_object.id}: residual {100 * found.residual:.2f} %{warning}\n")
    if not any(options.out.glob("*.ply")):
        raise UserError(f"{options.results}: expected a result named after an object, found none")
    return done


def main(options: Options) -> int:
    """Enter the results, and report on them if asked to."""
    enter(options)
    if options.report is None:
        return 0
    from gscomplete.cli.report import ReportOptions, run

    runs = (f"{options.system}={options.out}",)
    return run(ReportOptions(dataset=options.dataset, runs=runs, out=options.report))


if __name__ == "__main__":
    start(main, Options, __doc__)
