"""``gscomplete evaluate``: measure completions, one by one or over a dataset.

Conventions
-----------
* Exit code 0: everything found was measured; 1: a completion is missing or could not be measured.
* With ``--keep`` a completion that was measured before, from the same files, is not measured again.
* A method is named after its folder of runs, or its file; ``NAME=PATH`` gives another name.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from gscomplete.errors import UserError
from gscomplete.util.file_names import require_destination, shown_name, splat_stem

if TYPE_CHECKING:
    from gscomplete.evaluate.kept import Kept
    from gscomplete.evaluate.report import EvaluationSettings
    from gscomplete.evaluate.rows import Row
    from gscomplete.evaluate.subject import Subject


@dataclass(frozen=True)
class EvaluateOptions:
    """Measure how well completions keep P, and how close they are to the truth if it is known.

    Measures the change of P's appearance (E_color, E_depth, E_LPIPS, weighted by P's coverage) from
    the input view c and over V; likeness (S_CLIP, HaarPSI); and, if the complete object is known,
    silhouette IoU, colour of hidden regions and hidden surface. For another system's result,
    --object names the object folder that it completes.

    Examples: gscomplete evaluate runs/mug;
    gscomplete evaluate --dataset open --runs ours=runs/default fast=runs/fast --latex table.tex
    """

    paths: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Run folders, or splat files in P's coordinates."""
    object: Path | None = None
    """Object folder that PATHS complete; None = as each run records."""
    dataset: Path | None = None
    """Folder of object folders, instead of PATHS."""
    runs: tuple[str, ...] = ()
    """With --dataset: one folder of completions per method; NAME=FOLDER names the method. In it,
    ID or ID_completed is the run folder of object ID, or ID.ply (or another format) its splats."""
    keep: Path | None = None
    """With --dataset: keep measurements in this folder, so that the same command can continue."""
    views: int = 16
    """Number of views of V to average over."""
    truth_views: int = 12
    """Number of views around the object that are compared with the truth."""
    size_px: int = 256
    """Side of the pictures that are compared, in pixels."""
    json: bool = False
    """Print only one JSON object with every row."""
    csv: Path | None = None
    """Write every row to this file as CSV."""
    markdown: Path | None = None
    """Write the tables to this file as Markdown, including a row for every object."""
    latex: Path | None = None
    """Write the table to this file as LaTeX (booktabs)."""


def run(options: EvaluateOptions) -> int:
    """Measure; return the exit code."""
    from gscomplete.evaluate.tables import markdown, unavailable_of
    from gscomplete.util import jsonio

    check_tables(options.csv, options.markdown, options.latex)
    jobs = list_jobs(options)
    failures: list[Failure] = []
    rows = [found.row for found in measured(jobs, options, failures)]
    tell(failures)
    if not rows:
        raise UserError("expected completions to measure, found none")
    write_tables(rows, options.csv, options.markdown, options.latex)
    if options.json:
        told = [failure.text() for failure in failures]
        print(json.dumps({"rows": [jsonio.to_json(row) for row in rows], "failures": told}))
    else:
        print(markdown(rows, per_object=options.dataset is None))
        for name, why in unavailable_of(rows):
            print(f"{name}: unavailable: {why}")
    return 1 if failures else 0


def check_tables(csv: Path | None, markdown: Path | None, latex: Path | None) -> None:
    """Check where the tables go before anything is measured.

    Raises:
        UserError: one is not named as a table of its kind, or cannot be written there.
    """
    require_destination("--csv", csv, (".csv", ".tsv", ".txt"))
    require_destination("--markdown", markdown, (".md", ".markdown", ".txt"))
    require_destination("--latex", latex, (".tex", ".txt"))


def write_tables(
    rows: Sequence[Row], csv: Path | None, markdown: Path | None, latex: Path | None
) -> None:
    """Write the tables that have a file.

    Raises:
        UserError: a folder cannot be written.
    """
    from gscomplete.evaluate import tables
    from gscomplete.util.atomic import atomic_path

    for path, text in (
        (csv, tables.csv_text(rows)),
        (markdown, tables.markdown(rows, per_object=True)),
        (latex, tables.latex(rows)),
    ):
        if path is not None:
            with atomic_path(path) as temporary:
                temporary.write_text(shown_name(text), encoding="utf-8")


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


@dataclass(frozen=True, slots=True)
class Failure:
    """A completion that was not measured."""

    method: str
    object: str
    reason: str

    def text(self) -> str:
        """Return the failure as one line of text."""
        return f"{self.method}: {self.object}: {self.reason}"


def tell(failures: Sequence[Failure]) -> None:
    """List on standard error what was not measured, a line for every method and reason."""
    for method, reason in dict.fromkeys((f.method, f.reason) for f in failures):
        names = ", ".join(f.object for f in failures if (f.method, f.reason) == (method, reason))
        print(f"gscomplete: not measured: {method}: {names}: {reason}", file=sys.stderr)


def list_jobs(options: EvaluateOptions) -> list[Job]:
    """List what is to be measured.

    Raises:
        UserError: the options do not fit each other, or name nothing.
    """
    from gscomplete.evaluate.subject import find_completion, objects_of

    if (options.dataset is None) == (not options.paths):
        raise UserError("expected either run folders and splat files, or --dataset with --runs")
    if options.dataset is None:
        for name, value in (("--runs", options.runs), ("--keep", options.keep)):
            if value:
                raise UserError(f"{name}: expected together with --dataset")
        jobs = [named(str(path)) for path in options.paths]
        for number, job in enumerate(jobs):
            if job in jobs[:number]:
                raise UserError(f"{job[1]}: expected each completion once, found it again")
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
    return splat_stem(plain.name) or plain.resolve().name, plain


def measured(
    jobs: list[Job],
    options: EvaluateOptions,
    failures: list[Failure],
    draw: Callable[[Subject, Row], dict[str, Any]] | None = None,
    drawn_with: Any = None,
) -> Iterator[Kept]:
    """Measure one completion after another, with a bar on standard error.

    Args:
        jobs: as ``list_jobs`` gives them.
        options: how to measure, and where to keep it.
        failures: completions that cannot be measured are appended to it.
        draw: makes a page's card; None = there is no page.
        drawn_with: JSON values that decide the card.

    Raises:
        UserError: an option is out of range, or the only job cannot be measured.
    """
    from rich.console import Console
    from rich.progress import track

    from gscomplete.evaluate.kept import KeptResults
    from gscomplete.evaluate.perceptual import found_here
    from gscomplete.util import jsonio

    settings = settings_of(options)
    kept = None
    if options.keep is not None:
        # What could not be measured is measured once its weights are there.
        decides = [jsonio.to_json(settings), drawn_with, found_here()]
        kept = KeptResults(options.keep, decides)
    for job in track(jobs, "measuring", console=Console(file=sys.stderr), disable=len(jobs) == 1):
        if job.path is None:
            failures.append(Failure(job.method, job.object, "no finished completion"))
            continue
        sources = [path for path in (job.path, job.owner) if path is not None]
        found = None if kept is None else kept.find(job.method, job.object, sources)
        if found is None:
            try:
                found = _measure(job.path, job, settings, draw)
            except UserError as error:
                if len(jobs) == 1:
                    raise
                failures.append(Failure(job.method, job.object, str(error)))
                continue
            if kept is not None:
                kept.add(job.method, job.object, sources, found)
        yield found


def _measure(
    path: Path,
    job: Job,
    settings: EvaluationSettings,
    draw: Callable[[Subject, Row], dict[str, Any]] | None,
) -> Kept:
    """Measure a completion, and draw it if there is a page."""
    from gscomplete.evaluate.kept import Kept
    from gscomplete.evaluate.report import evaluate
    from gscomplete.evaluate.rows import row_of
    from gscomplete.evaluate.subject import read_subject

    subject = read_subject(path, job.method, job.owner)
    report = evaluate(
        subject.completed, subject.partial, subject.views, truth=subject.truth, settings=settings
    )
    for warning in subject.warnings:
        print(f"gscomplete: {job.method}: {subject.object}: {warning}", file=sys.stderr)
    notes = (*subject.notes, *subject.warnings)
    row = row_of(report, job.method, subject.object, subject.subset, subject.seconds, notes)
    return Kept(row, None if draw is None else draw(subject, row))
