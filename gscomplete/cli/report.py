"""``gscomplete report``: one self-contained HTML page about completions."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gscomplete.cli.evaluate import EvaluateOptions, list_jobs, measured_subjects, settings_of
from gscomplete.errors import UserError


@dataclass(frozen=True)
class ReportOptions:
    """Write one HTML page that opens without a network.

    Input and completion side by side with errors inset, splats to turn in the browser (WebGL 2),
    numbers in tables that sort, options, timings and warnings.

    Examples: gscomplete report runs/mug;
    gscomplete report --dataset open --runs ours=runs/default other=runs/other --out page.html
    """

    paths: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Run folders, or splat files in P's coordinates."""
    object: Path | None = None
    """Object folder that PATHS complete; None = as each run says."""
    dataset: Path | None = None
    """Folder of object folders, instead of PATHS."""
    runs: tuple[str, ...] = ()
    """With --dataset: folders with one completion an object; NAME=FOLDER names the method."""
    out: Path = Path("report.html")
    """The page; replaced if it exists."""
    title: str = "Completions"
    """Heading of the page."""
    most_splats: int = 12_000
    """Of a completion with more, an even choice is put into the page, widened to match; 24 bytes
    each."""
    views: int = 16
    """Views of V averaged over."""
    truth_views: int = 12
    """Views round the object that are compared with the truth."""
    size_px: int = 256
    """Side of the pictures that are compared."""


def run(options: ReportOptions) -> int:
    """Measure, draw and write; return the exit code: 1 where a completion is missing."""
    from gscomplete.report.cards import card_of
    from gscomplete.report.page import write_page

    if not 100 <= options.most_splats <= 1_000_000:
        raise UserError(f"--most-splats: expected 100 to 1,000,000, found {options.most_splats}")
    asked = EvaluateOptions(
        paths=options.paths,
        object=options.object,
        dataset=options.dataset,
        runs=options.runs,
        views=options.views,
        truth_views=options.truth_views,
        size_px=options.size_px,
    )
    settings = settings_of(asked)
    failures: list[str] = []
    rows, cards = [], []
    for subject, row in measured_subjects(list_jobs(asked), settings, failures):
        rows.append(row)
        cards.append(card_of(subject, row, options.most_splats))
    for failure in failures:
        print(f"gscomplete: not measured: {failure}", file=sys.stderr)
    if not rows:
        raise UserError("expected completions to show, found none")
    write_page(options.out, options.title, rows, cards)
    size = options.out.stat().st_size / 2**20
    print(f"written: {options.out} ({len(rows)} completions, {size:.1f} MB)")
    return 1 if failures else 0
