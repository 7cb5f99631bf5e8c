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
from gscomplete.folders import ObjectFolder
from gscomplete.splats import Splats, read_splats, write_splats
from gscomplete.splats.formats.any_file import read_any_splats
from gscomplete.splats.ply import PlyError
from gscomplete.splats.transform import transform_splats
from gscomplete.util import jsonio
from recipes.baselines.here import METHODS, completed_here, read_part
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
    out: Path
    """Folder for ID.ply; what is there already is kept."""
    results: Path | None = None
    """Folder of the system's files, named after the objects; None = it is made here."""
    bank: Path | None = None
    """With ``nearest_mesh``: the file of ``recipes.baselines.bank``."""
    count: int = 60_000
    """Splats that a mesh becomes."""
    rotations: int = 1000
    """Rotations that the alignment tries."""
    report: Path | None = None
    """Measure all that is in OUT and write this HTML page."""
    beside: tuple[str, ...] = ()
    """With --report: other folders of runs; NAME=FOLDER names the method."""


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
    """Make, or convert and align, what there is.

    Returns:
        What ``alignment.json`` says; of baselines made here, why objects have none.

    Raises:
        UserError: the system is not registered, or there is no result at all.
    """
    if options.system not in SYSTEMS:
        known = ", ".join(SYSTEMS)
        raise UserError(f"SYSTEM: expected one of {known}, found {options.system!r}")
    made_here = options.system in METHODS
    if made_here != (options.results is None):
        expected = "none: it is made here" if made_here else "the folder of the system's files"
        raise UserError(f"{options.system}: --results: expected {expected}")
    options.out.mkdir(parents=True, exist_ok=True)
    objects = objects_of(options.dataset)
    done = _make(options, objects) if made_here else _align(options, objects)
    if not any(options.out.glob("*.ply")):
        raise UserError(f"{options.results}: expected a result named after an object, found none")
    return done


def _make(options: Options, objects: list[ObjectFolder]) -> dict[str, Any]:
    """Complete every object here; say which could not be and why."""
    failures: dict[str, str] = {}
    for known_object in objects:
        target = options.out / f"{known_object.id}.ply"
        if target.is_file():
            continue
        try:
            part = read_part(known_object, options.bank)
            write_splats(target, completed_here(options.system, part))
        except UserError as error:
            failures[known_object.id] = str(error)
            sys.stdout.write(f"{known_object.id}: {error}\n")
    if failures and not any(options.out.glob("*.ply")):
        raise UserError(next(iter(failures.values())))
    return failures


def _align(options: Options, objects: list[ObjectFolder]) -> dict[str, Any]:
    """Convert and align what the system made; return what ``alignment.json`` says."""
    assert options.results is not None
    record = options.out / ALIGNMENT_FILE
    done: dict[str, Any] = jsonio.read_json(record) if record.is_file() else {}
    for known_object in objects:
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
    return done


def main(options: Options) -> int:
    """Enter the results, and report on them if asked to."""
    enter(options)
    if options.report is None:
        return 0
    from gscomplete.cli.report import ReportOptions, run

    runs = (f"{options.system}={options.out}", *options.beside)
    return run(ReportOptions(dataset=options.dataset, runs=runs, out=options.report))


if __name__ == "__main__":
    start(main, Options, __doc__)
