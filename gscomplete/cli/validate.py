"""The command ``gscomplete validate``: is this file a sound splat PLY, and what is odd about it.

Conventions
-----------
* Exit code 0: no file has an error (warnings are allowed); 1: at least one has.
* ``--json`` prints one object: ``ok`` for all files, and one report per file under ``files``.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.markup import escape

from gscomplete.errors import UserError

if TYPE_CHECKING:
    from gscomplete.splats.validation import ValidationReport

_STYLES = {"error": "bold red", "warning": "yellow", "info": "dim"}


@dataclass(frozen=True)
class ValidateOptions:
    """Check splat files: list errors and warnings with counts, and give a verdict."""

    files: Annotated[list[Path], tyro.conf.Positional]
    """Splat files, or folders whose PLY files are checked. Files of other formats are converted to
    PLY and checked as that."""

    json: bool = False
    """Print one JSON object instead of text."""


def run(options: ValidateOptions) -> int:
    """Check the files and print the reports.

    Returns:
        0 when no file has an error, else 1.

    Raises:
        UserError: no file was given, or a folder holds none.
    """
    from gscomplete.folders import splat_files_of

    if not options.files:
        raise UserError("expected at least one FILE to check, found none")
    reports = [_checked(file) for path in options.files for file in splat_files_of(path)]
    ok = all(report.ok for report in reports)
    if options.json:
        data = {"ok": ok, "files": [report.to_json() for report in reports]}
        sys.stdout.write(json.dumps(data, indent=2) + "\n")
    else:
        console = _PipedConsole(highlight=False, soft_wrap=True)
        for report in reports:
            _print_report(console, report)
    return 0 if ok else 1


def _checked(path: Path) -> ValidationReport:
    """Check a file of any format; every fault is a finding."""
    from gscomplete.splats.formats.any_file import as_ply
    from gscomplete.splats.validation import Finding, ValidationReport, validate_file

    try:
        with as_ply(path) as (plain, notes):
            report = validate_file(plain)
    except UserError as error:
        finding = Finding("unreadable", "error", 1, str(error).removeprefix(f"{path}: "))
        return ValidationReport(str(path), False, 0, None, None, (finding,))
    how = tuple(Finding("converted", "info", 1, note) for note in notes)
    return dataclasses.replace(report, path=str(path), findings=(*report.findings, *how))


class _PipedConsole(Console):
    """A console whose exit code does not say that a file is damaged when its reader has gone."""

    def on_broken_pipe(self) -> None:
        """Raise what ``run_guarded`` knows; rich would exit with 1."""
        raise BrokenPipeError


def _print_report(console: Console, report: ValidationReport) -> None:
    """Print one report as text: the verdict, then a line for each finding."""
    verdict = "[green]ok[/green]" if report.ok else "[bold red]not ok[/bold red]"
    what = ""
    if report.sh_degree is not None:
        what = f", {report.n_splats} splats, SH degree {report.sh_degree}"
    console.print(f"{escape(report.path)}: {verdict}{what}")
    for finding in report.findings:
        style = _STYLES[finding.severity]
        label = f"[{style}]{finding.severity:7}[/{style}] {finding.name}"
        console.print(f"  {label} ({finding.count}): {escape(finding.message)}")
