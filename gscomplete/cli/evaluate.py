"""``gscomplete evaluate``: measure completions, one by one or over a dataset.

Conventions
-----------
* Exit code 0: everything found was measured; 1: a completion is missing or could not be measured.
* A method is named after its folder of runs, or its file; ``NAME=PATH`` gives another name.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from gscomplete.errors import UserError

if TYPE_CHECKING:
    from gscomplete.evaluate.report import EvaluationSettings
    from gscomplete.evaluate.rows import Row
    from gscomplete.evaluate.subject import Subject


@dataclass(frozen=True)
class EvaluateOptions:
    """Measure how well completions keep P and how near they are to the truth.

    Errors of the input (E_color, E_depth, E_LPIPS, weighted by what P covers) from the input view c
    and over V; likeness (S_CLIP, HaarPSI); with a known complete object its silhouettes, hidden
    colours and hidden surface. Of another system's result, --object names what it completes.

    Examples: gscomplete evaluate runs/mug;
    gscomplete evaluate --dataset open --runs ours=runs/default fast=runs/fast --latex table.tex
    """

    paths: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Run folders, or splat files in P's coordinates."""
    object: Path | None = None
    """Object folder that PATHS complete; None = as each run says."""
    dataset: Path | None = None
    """Folder of object folders, instead of PATHS."""
    runs: tuple[str, ...] = ()
    """With --dataset: folders with one completion an object, each a method; NAME=FOLDER names it.
    In it, ID or ID_completed is a run folder, ID.ply a splat file."""
    views: int = 16
    """Views of V averaged over."""
    truth_views: int = 12
    """Views round the object that are compared with the truth."""
    size_px: int = 256
    """Side of the pictures that are compared."""
    json: bool = False
    """Print one JSON object with every row, and nothing else."""
    csv: Path | None = None
    """Write every row here."""
    markdown: Path | None = None
    """Write the tables here as Markdown, every object included."""
    latex: Path | None = None
    """Write the table here as LaTeX (booktabs)."""


def run(options: EvaluateOptions) -> int:
    """Measure; return the exit code."""
    from gscomplete.evaluate.tables import csv_text, latex, markdown
    from gscomplete.util import jsonio
    from gscomplete.util.atomic import atomic_path

    jobs = list_jobs(options)
    failures: list[str] = []
    rows = list(measured_rows(jobs, settings_of(options), failures))
    for failure in failures:
        print(f"gscomplete: not measured: {failure}", file=sys.stderr)
    if not rows:
        raise UserError("expected completions to measure, found none")
    for path, text in (
        (options.csv, csv_text(rows)),
        (options.markdown, markdown(rows, per_object=True)),
        (options.latex, latex(rows)),
    ):
        if path is not None:
            with atomic_path(path) as temporary:
                temporary.write_text(text, encoding="utf-8")
    if options.json:
        content = {"rows": [jsonio.to_json(row) for row in rows], "failures": failures}
        print(json.dumps(content))
    else:
        print(markdown(rows, per_object=options.dataset is None))
        for name, why in sorted({pair for row in rows for pair in row.unavailable.items()}):
            print(f"{name}: unavailable: {why}")
    return 1 if failures else 0


def settings_of(options: EvaluateOptions) -> EvaluationSettings:
    """Return the settings that the options ask for.

    Raises:
        UserError: a number is out of range.
    """
    from gscomplete.evaluate.report import EvaluationSettings

    for name, value, low, high in (
        ("--views", options.views, 1, 1000),
        ("--truth-views", options.truth_views, 1, 1000),
        ("--size-px", options.size_px, 32, 4096),
    ):
        if not low <= value <= high:
            raise UserError(f"{name}: expected {low} to {high}, found {value}")
    return EvaluationSettings(options.views, options.truth_views, options.size_px)


@dataclass(frozen=True, slots=True)
class Job:
    """A completion that is to be measured; without a path, one that is missing."""

    path: Path | None
    method: str
    owner: Path | None
    object: str


def list_jobs(options: EvaluateOptions) -> list[Job]:
    """List what is to be measured.

    Raises:
        UserError: the options do not fit each other, or name nothing.
    """
    from gscomplete.evaluate.subject import find_completion, objects_of

    if (options.dataset is None) == (not options.paths):
        raise UserError("expected either run folders and splat files, or --dataset with --runs")
    if options.dataset is None:
        if options.runs:
            raise UserError("--runs: expected together with --dataset")
        jobs = [named(str(path)) for path in options.paths]
        return [Job(path, method, options.object, path.name) for method, path in jobs]
    if not options.runs:
        raise UserError("--runs: expected at least one folder of runs, found none")
    methods = [named(text) for text in options.runs]
    names = [name for name, _ in methods]
    if len(set(names)) < len(names):
        raise UserError(f"--runs: expected a name for each, such as NAME=FOLDER, found {names}")
    for _, folder in methods:
        if not folder.is_dir():
            raise UserError(f"{folder}: --runs: expected a folder of runs, found none")
    return [
        Job(find_completion(folder, known.id), method, known.folder, known.id)
        for known in objects_of(options.dataset)
        for method, folder in methods
    ]


def named(text: str) -> tuple[str, Path]:
    """Split NAME=PATH; a path alone is named after its last part."""
    name, equals, path = text.partition("=")
    if equals and name and path and "/" not in name:
        return name, Path(path)
    plain = Path(text)
    return plain.stem if plain.suffix == ".ply" else plain.resolve().name, plain


def measured_rows(
    jobs: list[Job], settings: EvaluationSettings, failures: list[str]
) -> Iterator[Row]:
    """Measure one completion after another; what cannot be measured goes to ``failures``."""
    for _, row in measured_subjects(jobs, settings, failures):
        yield row


def measured_subjects(
    jobs: list[Job], settings: EvaluationSettings, failures: list[str]
) -> Iterator[tuple[Subject, Row]]:
    """Measure one completion after another, with a bar on standard error."""
    from rich.console import Console
    from rich.progress import track

    from gscomplete.evaluate.report import evaluate
    from gscomplete.evaluate.rows import row_of
    from gscomplete.evaluate.subject import read_subject

    for job in track(jobs, "measuring", console=Console(file=sys.stderr), disable=len(jobs) == 1):
        if job.path is None:
            failures.append(f"{job.method}: {job.object}: no finished completion")
            continue
        try:
            subject = read_subject(job.path, job.method, job.owner)
            report = evaluate(
                subject.completed,
                subject.partial,
                subject.views,
                truth=subject.truth,
                settings=settings,
            )
        except UserError as error:
            if len(jobs) == 1:
                raise
            failures.append(f"{job.method}: {job.object}: {error}")
            continue
        yield (
            subject,
            row_of(
                report, job.method, subject.object, subject.subset, subject.seconds, subject.notes
            ),
        )
