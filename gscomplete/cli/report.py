"""``gscomplete report``: one self-contained HTML page about completions."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gscomplete.cli.evaluate import (
    EvaluateOptions,
    Failure,
    check_tables,
    list_jobs,
    measured,
    tell,
    write_tables,
)
from gscomplete.errors import UserError
from gscomplete.util.file_names import require_destination


@dataclass(frozen=True)
class ReportOptions:
    """Write one HTML page about completions that opens without a network.

    It has input and completion side by side with error maps inset, splats to turn in the browser
    (WebGL 2), metrics in sortable tables, options, timings and warnings.

    Examples: gscomplete report runs/mug;
    gscomplete report --dataset open --runs ours=runs/default other=runs/other --out page.html
    """

    paths: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Run folders, or splat files in P's coordinates."""
    object: Path | None = None
    """Object folder that PATHS complete; None = as each run records."""
    dataset: Path | None = None
    """Folder of object folders, instead of PATHS."""
    runs: tuple[str, ...] = ()
    """With --dataset: one folder of completions per method; NAME=FOLDER names the method."""
    keep: Path | None = None
    """With --dataset: keep measurements in this folder, so that the same command can continue."""
    out: Path = Path("report.html")
    """The page; replaced if it exists."""
    title: str = "Completions"
    """Heading of the page."""
    csv: Path | None = None
    """Write every row to this file as CSV."""
    markdown: Path | None = None
    """Write the tables to this file as Markdown, including a row for every object."""
    latex: Path | None = None
    """Write the table to this file as LaTeX (booktabs)."""
    most_splats: int = 6000
    """If the input, or the new splats, are more than this, the page holds an even subset, with
    splats enlarged to match. A splat takes 23 bytes."""
    views: int = 16
    """Number of views of V to average over."""
    truth_views: int = 12
    """Number of views around the object that are compared with the truth."""
    size_px: int = 256
    """Side of the pictures that are compared, in pixels."""


def run(options: ReportOptions) -> int:
    """Measure, draw and write; return the exit code: 1 where a completion is missing."""
    from gscomplete.report.cards import card_of
    from gscomplete.report.page import write_page

    require_destination("--out", options.out, (".html", ".htm"))
    check_tables(options.csv, options.markdown, options.latex)
    if not 100 <= options.most_splats <= 1_000_000:
        raise UserError(f"--most-splats: expected 100 to 1,000,000, found {options.most_splats}")
    asked = EvaluateOptions(
        paths=options.paths,
        object=options.object,
        dataset=options.dataset,
        runs=options.runs,
        keep=options.keep,
        views=options.views,
        truth_views=options.truth_views,
        size_px=options.size_px,
    )
    failures: list[Failure] = []
    rows, cards = [], []
    draw = functools.partial(card_of, most_splats=options.most_splats)
    for found in measured(list_jobs(asked), asked, failures, draw, options.most_splats):
        assert found.card is not None
        rows.append(found.row)
        cards.append(found.card)
    tell(failures)
    if not rows:
        raise UserError("expected completions to show, found none")
    write_tables(rows, options.csv, options.markdown, options.latex)
    write_page(options.out, options.title, rows, cards)
    size = options.out.stat().st_size / 2**20
    print(f"written: {options.out} ({len(rows)} completions, {size:.1f} MB)")
    return 1 if failures else 0
