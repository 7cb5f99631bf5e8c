"""``splatcomplete-data build | validate | stats | list``: datasets."""

from __future__ import annotations

import dataclasses
import json
import statistics
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatcomplete_data.cli.common import progress, say

if TYPE_CHECKING:
    from splatcomplete_data.dataset.build import Outcome


_SHEET = Path("contact_sheet.png")
"""Picture of ``stats`` where none is named."""


@dataclass(frozen=True, kw_only=True)
class BuildOptions:
    """Build all objects of a recipe.

    Objects that were made from the same recipe entry and sources by the same code are up to date
    and not made again. If a build was killed, the same command continues it. If an object fails,
    the others go on; the exit code is then 1.

    Example: splatcomplete-data build recipes/splatcomplete_open/recipe.yaml --data ../shared/data
    """

    recipe: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RECIPE")]
    """YAML file; splatcomplete_data/dataset/recipe.py documents its fields."""
    data: Path = Path()
    """Folder that the recipe's paths are relative to."""
    out: Path = Path("dataset")
    """Dataset folder."""
    jobs: Annotated[int | None, tyro.conf.arg(aliases=("--workers",))] = None
    """Number of worker processes, each making one object at a time; None = one per core, at most
    8."""
    only: tuple[str, ...] = ()
    """Ids of objects to build; none = all."""
    allow_outside: Path | None = None
    """Another folder from which files named by the recipe, a mesh or a capture may be read, besides
    --data and the mesh's or capture's own folder; None = --data."""
    any_code: bool = False
    """Keep objects made by another version of the code; otherwise they are made again."""
    json: bool = False
    """Print only one JSON object on standard output; messages go to standard error."""


@dataclass(frozen=True, kw_only=True)
class ValidateOptions:
    """Check a dataset or an object folder and list every fault.

    The exit code is 1 if there is an error; warnings do not count.
    """

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Dataset or object folder."""
    json: bool = False
    """Print one JSON object instead of text."""


@dataclass(frozen=True, kw_only=True)
class StatsOptions:
    """Print what a dataset contains, and draw its contact sheet.

    Folders without an object, and objects that are not in the recipe of the last build, are skipped
    with a note.
    """

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Dataset or object folder."""
    sheet: Path | None = None
    """Picture to write; None = contact_sheet.png in the current folder."""
    json: bool = False
    """Print one JSON object instead of text; no picture without --sheet."""


@dataclass(frozen=True, kw_only=True)
class ListOptions:
    """List the objects of a dataset.

    Folders without an object, and objects that are not in the recipe of the last build, are skipped
    with a note.
    """

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Dataset or object folder."""
    json: bool = False
    """Print one JSON object instead of text."""


def run_build(options: BuildOptions) -> int:
    """Build the dataset; return the exit code."""
    from gscomplete.batch.machine import usable_cores
    from splatcomplete_data.dataset.build import build
    from splatcomplete_data.dataset.recipe import read_recipe

    recipe = read_recipe(options.recipe)
    workers = min(usable_cores(), 8) if options.jobs is None else options.jobs
    with progress("objects") as report:

        def show(outcome: Outcome, done: int, total: int) -> None:
            report(done, total)
            if outcome.status != "up to date":
                say(options, f"{outcome.status}: {outcome.id}")

        outcomes = build(
            recipe,
            options.data,
            options.out,
            workers=workers,
            only=options.only,
            allow_outside=options.allow_outside,
            any_code=options.any_code,
            on_outcome=show,
        )
    counts = Counter(outcome.status for outcome in outcomes)
    failed = [outcome for outcome in outcomes if outcome.status == "failed"]
    if options.json:
        data = {"counts": counts, "outcomes": [dataclasses.asdict(o) for o in outcomes]}
        sys.stdout.write(json.dumps(data) + "\n")
    else:
        say(options, ", ".join(f"{counts[s]} {s}" for s in ("built", "up to date", "failed")))
        say(options, *(f"failed: {outcome.id}: {outcome.message}" for outcome in failed))
    return 1 if failed else 0


def run_validate(options: ValidateOptions) -> int:
    """Check the dataset; return the exit code."""
    from splatcomplete_data.dataset.validate import validate_dataset

    count, findings = validate_dataset(options.folder)
    errors = [finding for finding in findings if finding.severity == "error"]
    if options.json:
        rows = [dataclasses.asdict(finding) for finding in findings]
        data = {"ok": not errors, "objects": count, "findings": rows}
        sys.stdout.write(json.dumps(data) + "\n")
    else:
        say(options, *(f"{f.severity}: {f.object}: {f.name}: {f.message}" for f in findings))
        verdict = "ok" if not errors else "not ok"
        warnings = len(findings) - len(errors)
        say(options, f"{verdict}: {count} objects, {len(errors)} errors, {warnings} warnings")
    return 1 if errors else 0


def run_stats(options: StatsOptions) -> int:
    """Print the table and draw the sheet; return the exit code."""
    from gscomplete.evaluate.pictures import require_own_picture, save_image
    from splatcomplete_data.dataset.stats import draw_sheet, survey

    if options.sheet is None and not options.json:
        require_own_picture(_SHEET)
    found = survey(options.folder)
    rows = found.rows
    subsets = sorted({row.subset for row in rows})
    lines = [
        f"{'subset':12} {'objects':>7} {'splats of the parts':>26} {'with truth':>10} {'MB':>8}"
    ]
    summary = {}
    for subset in subsets:
        mine = [row for row in rows if row.subset == subset]
        parts = sorted(row.partial or row.complete for row in mine)
        spread = f"{parts[0]:,} / {statistics.median(parts):,.10g} / {parts[-1]:,}"
        known = sum(row.complete > 0 for row in mine)
        size = sum(row.megabytes for row in mine)
        lines.append(f"{subset:12} {len(mine):7} {spread:>26} {known:10} {size:8.1f}")
        summary[subset] = {"objects": len(mine), "splats": parts, "with_truth": known, "mb": size}
    lines.append("splats of the parts: fewest / median / most")
    if options.json:
        data = {"subsets": summary, "objects": [dataclasses.asdict(row) for row in rows]}
        sys.stdout.write(json.dumps(data) + "\n")
    else:
        say(options, *lines)
    say(options, *found.notes)
    if options.sheet is not None or not options.json:
        path = options.sheet or _SHEET
        save_image(draw_sheet(options.folder, rows), path)
        say(options, f"written: {path}")
    return 0


def run_list(options: ListOptions) -> int:
    """List the objects; return the exit code."""
    from splatcomplete_data.dataset.stats import survey

    found = survey(options.folder)
    rows = found.rows
    if options.json:
        say(options, *found.notes)
        sys.stdout.write(json.dumps([dataclasses.asdict(row) for row in rows]) + "\n")
        return 0
    width = max(len(row.id) for row in rows)
    for row in rows:
        of_complete = f" of {row.complete:,}" if row.complete else ""
        count = f"{row.partial:,}{of_complete}"
        say(options, f"{row.subset:10} {row.id:{width}} {count:>20}  {row.prompt}")
    say(options, *found.notes)
    return 0
