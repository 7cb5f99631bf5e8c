"""Run the stress table: ``python -m recipes.stress_numerics [--quick] [--json OUT] [--rows ...]``.

The exit code is 1 when a check fails.
"""

from __future__ import annotations

import dataclasses
import json
import logging
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gscomplete.util.atomic import atomic_path
from recipes.entry_point import start


@dataclass(frozen=True)
class Options:
    """Feed extremes to the renderer, the files and the completion, and check what comes back."""

    quick: bool = False
    """Smaller sizes: under a minute on one core."""
    json: Path | None = None
    """File for all checks; None = none."""
    rows: tuple[str, ...] = ()
    """Names of the rows to run; none = all."""


def run_row(row: Any, quick: bool) -> dict[str, Any]:
    """Run a row; an exception is a failed check that names it."""
    from recipes.stress_numerics.rows import Check

    started = time.perf_counter()
    checks: list[Check] = []
    try:
        checks.extend(row.run(quick))
    except Exception as error:  # whatever went wrong belongs in the table
        logging.getLogger(__name__).exception("row %s", row.name)
        checks.append(Check(f"{type(error).__name__}: {error}"[:160], float("inf"), 0))
    return {
        "row": row.name,
        "fed": row.fed,
        "passed": all(check.passed for check in checks) and bool(checks),
        "seconds": round(time.perf_counter() - started, 2),
        "checks": [{**dataclasses.asdict(check), "passed": check.passed} for check in checks],
        "worst": dataclasses.asdict(max(checks, key=lambda check: check.strain)),
    }


def show(results: list[dict[str, Any]]) -> None:
    """Print the table."""
    from rich.console import Console
    from rich.table import Table

    table = Table("row", "fed", "checks", "nearest to its limit", "value", "limit", "", "s")
    for result in results:
        worst = result["worst"]
        failed = sum(not check["passed"] for check in result["checks"])
        table.add_row(
            result["row"],
            result["fed"],
            str(len(result["checks"])),
            worst["what"],
            f"{worst['value']:.3g}",
            f"{worst['limit']:.3g}",
            "pass" if result["passed"] else f"[bold red]{failed} FAIL",
            f"{result['seconds']:.1f}",
        )
    console = Console(width=None if sys.stdout.isatty() else 180)
    console.print(table)


def main(options: Options) -> int:
    """Run the rows asked for; return the exit code."""
    from gscomplete.errors import UserError
    from recipes.stress_numerics.completion_rows import COMPLETION_ROWS
    from recipes.stress_numerics.file_rows import FILE_ROWS
    from recipes.stress_numerics.splat_rows import SPLAT_ROWS
    from recipes.stress_numerics.view_rows import VIEW_ROWS

    rows = {row.name: row for row in (*SPLAT_ROWS, *VIEW_ROWS, *FILE_ROWS, *COMPLETION_ROWS)}
    unknown = [name for name in options.rows if name not in rows]
    if unknown:
        raise UserError(f"--rows: expected some of {', '.join(rows)}; found {', '.join(unknown)}")
    chosen = [rows[name] for name in options.rows] or list(rows.values())
    results = []
    for row in chosen:
        results.append(run_row(row, options.quick))
        outcome = "pass" if results[-1]["passed"] else "FAIL"
        sys.stderr.write(f"{outcome} {row.name} {results[-1]['seconds']:.1f} s\n")
    show(results)
    if options.json is not None:
        with atomic_path(options.json) as temporary:
            temporary.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    return 0 if all(result["passed"] for result in results) else 1


if __name__ == "__main__":
    start(main, Options, __doc__)
