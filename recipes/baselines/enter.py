"""Enter other systems' results: ``python -m recipes.baselines.enter SYSTEM --dataset DIR ...``.

Every object of the dataset for which ``--results`` holds a mesh or splat file ``ID.glb``, ``.obj``,
``.ply``, ``.spz``, ... (or a folder ``ID`` with one such file) gets ``OUT/ID.ply``: converted to
splats and aligned to P, ready for ``gscomplete report --dataset DIR --runs SYSTEM=OUT``.
``OUT/alignment.json`` records each alignment and its doubts; ``--report`` also measures and writes
the page. A result that cannot be read is reported and skipped; the same command resumes where it
was stopped.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from gscomplete.cli.report import ReportOptions, run
from gscomplete.errors import UserError
from gscomplete.evaluate.align import AlignmentSettings, align_splats
from gscomplete.evaluate.subject import objects_of
from gscomplete.folders import ObjectFolder
from gscomplete.splats import Splats, read_splats, write_splats
from gscomplete.splats.formats.any_file import READ, read_any_splats
from gscomplete.splats.transform import transform_splats
from gscomplete.util import jsonio
from recipes.baselines.registry import SYSTEMS
from recipes.entry_point import start
from splatcomplete_data.mesh.convert import convert_mesh
from splatcomplete_data.mesh.files.load import load_mesh

_MESHES = (".glb", ".gltf", ".obj", ".ply", ".stl")
_SPLATS = tuple(f".{kind}" for kind in READ)
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
    """Splats to convert a mesh into."""
    rotations: int = 1000
    """Number of rotations that the alignment tries."""
    report: Path | None = None
    """Measure all results in OUT and write this HTML page."""
    beside: tuple[str, ...] = ()
    """With --report: other folders of runs; NAME=FOLDER names the method."""


def find_result(results: Path, object_id: str) -> Path | None:
    """Return a system's file of an object; None = there is none.

    Raises:
        UserError: there are several.
    """
    places = (*results.glob(f"{object_id}.*"), *(results / object_id).glob("*"))
    shown = (path for path in places if not path.name.startswith("."))  # macOS leaves ._ files
    found = sorted(path for path in shown if path.name.lower().endswith((*_MESHES, *_SPLATS)))
    if len(found) > 1:
        raise UserError(f"{found[0]}: expected one result of {object_id}, found {len(found)}")
    return found[0] if found else None


def read_result(path: Path, count: int) -> Splats:
    """Read a result as splats: splat files as they are, meshes covered with flat splats.

    Raises:
        UserError: it is neither, or damaged.
    """
    may_be_mesh = path.name.lower().endswith(_MESHES)
    if path.name.lower().endswith(_SPLATS):
        try:
            return read_any_splats(path).splats.with_sh_degree(0)
        except UserError:
            if not may_be_mesh:
                raise
    return convert_mesh(load_mesh(path), count).splats


def enter(options: Options) -> dict[str, str]:
    """Convert and align all results that exist; those that are already aligned are kept.

    Returns:
        Reasons why existing results of objects could not be entered.

    Raises:
        UserError: the system is neither registered nor made here, or there is no result at all.
    """
    if options.system not in SYSTEMS:
        known = ", ".join(SYSTEMS)
        raise UserError(f"SYSTEM: expected one of {known}, found {options.system!r}")
    if SYSTEMS[options.system].enters == ("made here",):
        raise UserError(f"{options.system}: it is made here: {SYSTEMS[options.system].how}")
    objects = objects_of(options.dataset)
    results: list[tuple[ObjectFolder, Path]] = []
    failures: dict[str, str] = {}
    for known_object in objects:
        try:
            result = find_result(options.results, known_object.id)
        except UserError as error:
            failures[known_object.id] = str(error)
            sys.stdout.write(f"{known_object.id}: {error}\n")
            continue
        if result is not None:
            results.append((known_object, result))
    if not results and not failures:
        raise UserError(f"{options.results}: expected a result named after an object, found none")
    options.out.mkdir(parents=True, exist_ok=True)
    for number, (known_object, path) in enumerate(results, 1):
        if (options.out / f"{known_object.id}.ply").is_file():
            continue
        try:
            told = _align(known_object, path, options)
        except UserError as error:
            failures[known_object.id] = told = str(error)
        sys.stdout.write(f"{number} of {len(results)}: {known_object.id}: {told}\n")
    return failures


def _align(known_object: ObjectFolder, path: Path, options: Options) -> str:
    """Convert and align one result; return what people are told of it."""
    record = options.out / ALIGNMENT_FILE
    done: dict[str, Any] = jsonio.read_json(record) if record.is_file() else {}
    splats = read_result(path, options.count)
    partial = read_splats(known_object.partial).splats
    found = align_splats(splats, partial, AlignmentSettings(options.rotations))
    done[known_object.id] = {
        "system": options.system,
        "file": path.name,
        "file_from_result": found.target_from_result.to_json(),
        "residual": found.residual,
        "runner_up": found.runner_up,
        "warning": found.warning(),
    }
    jsonio.write_json(record, done)
    placed = transform_splats(splats, found.target_from_result)
    write_splats(options.out / f"{known_object.id}.ply", placed)
    warning = f"; {found.warning()}" if found.warning() else ""
    return f"residual {100 * found.residual:.2f} %{warning}"


def main(options: Options) -> int:
    """Enter the results, and report on them if asked to; 1 = one could not be entered."""
    failures = enter(options)
    if options.report is None:
        return 1 if failures else 0
    runs = (f"{options.system}={options.out}", *options.beside)
    page = ReportOptions(dataset=options.dataset, runs=runs, out=options.report)
    return max(run(page), 1 if failures else 0)


if __name__ == "__main__":
    start(main, Options, __doc__)
