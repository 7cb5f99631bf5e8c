"""The command ``gscomplete batch``: complete many objects.

Conventions
-----------
* Exit code 0: all objects are finished; 1: at least one failed.
* ``--json`` prints one object: counts, seconds, the ledger's path, and each object's last row.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import re
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from gscomplete.cli.complete_options import HowToComplete, require_plain_fill
from gscomplete.errors import UserError
from gscomplete.util.parse import parse_numbers, parse_view

if TYPE_CHECKING:
    from gscomplete.batch.ledger import Row
    from gscomplete.batch.machine import WorkerPlan
    from gscomplete.batch.manifest import Item
    from gscomplete.batch.run import Batch, Summary
    from gscomplete.batch.work import Task

EMBEDDED_MEMORY_GIB = 2.0
"""Of a worker with the embedded prior: 1.1 GiB at most on 21 real objects, and room for larger."""
OTHER_MEMORY_GIB = 12.0
"""Of a worker with another prior: MVDream's weights in float32 and as much again."""
_MOST_RUNNING, _MOST_NAMED = 4, 8


@dataclass(frozen=True, kw_only=True)
class BatchOptions(HowToComplete):
    """Complete many objects, on all cores or GPUs of this machine or on a Ray cluster.

    SOURCE is a dataset of splatcomplete-data, a folder of object folders or splat files, or a
    manifest (.jsonl, .csv, .tsv) with one object per line: partial (splat file or object folder),
    id, and options of that object alone (prompt, up, view, ...). --prompt is for the objects that
    have none there and no object.json. RUNS/ID becomes the run folder of object ID, with the same
    bytes as "gscomplete complete" gives. If a batch was stopped or killed, the same command
    continues it; objects finished with the same input, options and weights are not made again. If
    an object fails, its error and log are kept and the others go on.

    SOURCE, RUNS and objects may be URLs (s3://bucket/folder, and any other that fsspec reads).

    Examples: gscomplete batch datasets/open --out runs/open;
    gscomplete batch scans.csv --out s3://lab/completed --ray auto
    """

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE")]
    """Dataset, folder or manifest, as a path or URL."""
    out: Annotated[str, tyro.conf.arg(metavar="RUNS")]
    """Folder for the run folders and the ledger (.batch/ledger.jsonl), as a path or URL."""
    workers: int | None = None
    """Worker processes; None = one per GPU, else as many as cores and memory allow."""
    threads: int | None = None
    """Threads per worker; None = the cores divided among the workers."""
    memory: float | None = None
    """GiB that must be free before a worker starts, and the most that a worker on the CPU may use;
    None = 2 with the embedded prior, else 12."""
    ray: tuple[str, ...] | None = None
    """Run on a Ray cluster: its address; no value or auto = the cluster that this machine is part
    of; local = a new cluster of this machine alone. Paths must be the same on all its machines."""
    retries: int = 2
    """How many more workers try an object whose worker died."""
    redo: bool = False
    """Complete objects again whose results in RUNS were made with other options or weights."""
    scratch: Path | None = None
    """Local folder for unfinished objects if RUNS is a URL; None = in the system's folder for
    temporary files."""
    json: bool = False
    """Print only one JSON object on standard output; messages go to standard error."""


def run(options: BatchOptions) -> int:
    """Complete the objects; return the exit code.

    Raises:
        UserError: an option or the manifest is wrong, or the machine cannot run a worker.
    """
    from gscomplete.batch.manifest import plan
    from gscomplete.batch.run import open_batch
    from gscomplete.cli.batch_job import ITEM_FIELDS, identity_of

    address = _address(options.ray)
    _check(options)
    items = plan(options.source, ITEM_FIELDS)
    _check_prompts(options, items)
    batch = open_batch(
        items, identity_of(options), options.out, scratch=options.scratch, redo=options.redo
    )
    before = len(items) - len(batch.to_do)
    _say(
        options,
        f"{len(items):,} objects" + (f", {before:,} of them already finished" if before else ""),
    )
    with contextlib.redirect_stdout(sys.stderr if options.json else sys.stdout):
        summary = _with_progress(options, batch, address)  # Ray prints what it likes
    _report(options, batch, summary)
    return 1 if summary.failed else 0


def _address(ray: tuple[str, ...] | None) -> str | None:
    """Return the address of the cluster; None = no cluster.

    Raises:
        UserError: there are several.
    """
    if ray is None:
        return None
    if len(ray) > 1:
        raise UserError(f"--ray: expected one address at most, found {len(ray)}")
    return ray[0] if ray else "auto"


def _check(options: BatchOptions) -> None:
    """Check what can be checked before a worker starts.

    Raises:
        UserError: an option is wrong.
    """
    if options.fill:
        require_plain_fill(options)
    parse_view(options.view)
    parse_numbers(options.center, 3, "--center", "X,Y,Z")
    if re.fullmatch(r"auto|cpu|cuda(:[0-9]+)?", options.device) is None:
        raise UserError(f"--device: expected auto, cpu, cuda or cuda:N, found {options.device!r}")
    for name, count in (("workers", options.workers), ("threads", options.threads)):
        if count is not None and count < 1:
            raise UserError(f"--{name}: expected 1 or more, found {count}")
    if options.memory is not None and not 0.001 <= options.memory < float("inf"):
        raise UserError(
            f"--memory: expected a number of GiB, at least 0.001, found {options.memory:g}"
        )
    if options.retries < 0:
        raise UserError(f"--retries: expected 0 or more, found {options.retries}")


def _check_prompts(options: BatchOptions, items: list[Item]) -> None:
    """Check that objects have prompts, as far as file names show it.

    Raises:
        UserError: some have none: splat files with no object.json beside them.
    """
    from gscomplete.batch import storage
    from gscomplete.util.file_names import OBJECT_FILE, splat_stem

    if options.prompt is not None or options.fill:
        return
    alone = [
        item
        for item in items
        if "prompt" not in item.options and splat_stem(item.source.rpartition("/")[2]) is not None
    ]
    folders = {item.source.rpartition("/")[0] for item in alone}
    bare = {f for f in folders if storage.signature(storage.join(f, OBJECT_FILE)) is None}
    lacking = [item.id for item in alone if item.source.rpartition("/")[0] in bare]
    if lacking:
        more = f" and {len(lacking) - _MOST_NAMED:,} more" if len(lacking) > _MOST_NAMED else ""
        raise UserError(
            "--prompt: expected a prompt for each object, by this option or in a manifest, found "
            f"none for {', '.join(lacking[:_MOST_NAMED])}{more}"
        )


def _plan(options: BatchOptions, items: int) -> WorkerPlan:
    """Choose the workers."""
    from gscomplete.batch.machine import GIB, WorkerPlan, plan_workers, visible_gpus

    default = EMBEDDED_MEMORY_GIB if options.prior == "embedded" else OTHER_MEMORY_GIB
    memory_bytes = round((options.memory or default) * GIB)
    on_gpus = options.device != "cpu"
    gpus = visible_gpus() if on_gpus else ()
    if options.device.startswith("cuda:"):
        gpus = gpus[int(options.device[5:]) :][:1]
    if options.ray is not None:
        return WorkerPlan(options.workers or 1, options.threads or 1, memory_bytes, gpus)
    return plan_workers(
        items,
        memory_bytes=memory_bytes,
        count=options.workers,
        threads=options.threads,
        gpus=gpus,
    )


def _with_progress(options: BatchOptions, batch: Batch, address: str | None) -> Summary:
    """Run with a progress bar on standard error."""
    from gscomplete.batch.run import Summary, run_batch
    from gscomplete.cli.bars import progress_bar
    from gscomplete.cli.batch_job import CompleteJob

    if not batch.to_do:
        return Summary(before=len(batch.items))
    workers = _plan(options, len(batch.to_do))
    how = {field.name: getattr(options, field.name) for field in dataclasses.fields(HowToComplete)}
    if workers.gpus:
        how["device"] = "cuda"  # a worker sees no GPU but its own
    since: dict[str, float] = {}
    with progress_bar("objects", "{task.fields[running]}") as progress:
        bar = progress.add_task("objects", total=len(batch.to_do), running="")

        def show_row(row: Row) -> None:
            since.pop(row.id, None)
            progress.update(bar, advance=1)
            if row.status == "failed":
                _say(options, f"failed: {row.id}: {row.error}")
            else:
                count = row.facts.get("new_splats", 0)
                _say(options, f"{row.status}: {row.id}, {count:,} new splats, {row.seconds:.1f} s")

        def show_running(running: list[Task]) -> None:
            now = time.monotonic()
            texts = [
                f"{task.item.id} {now - since.setdefault(task.item.id, now):.0f} s{_steps(task)}"
                for task in running[:_MOST_RUNNING]
            ]
            progress.update(bar, running=", ".join(texts))

        return run_batch(
            batch,
            CompleteJob(HowToComplete(**how)),
            workers,
            ray=address,
            retries=options.retries,
            on_row=show_row,
            on_tick=show_running,
        )


def _steps(task: Task) -> str:
    """Return how many steps a running object has taken, where it takes any, as words."""
    path = Path(task.work) / task.item.id / "log.jsonl"
    try:
        steps = path.read_bytes().count(b"\n")
    except OSError:
        return ""
    return f" step {steps}" if steps else ""


def _report(options: BatchOptions, batch: Batch, summary: Summary) -> None:
    """Print what came of the batch."""
    from gscomplete.batch.ledger import read_ledger
    from gscomplete.batch.run import LEDGER_FILE

    ledger = batch.state / LEDGER_FILE
    if options.json:
        rows = read_ledger(ledger)
        data = {
            "objects": len(batch.items),
            "counts": {"finished_before": summary.before, **summary.counts},
            "seconds": round(summary.seconds, 3),
            "ledger": str(ledger),
            "rows": [dataclasses.asdict(rows[i.id]) for i in batch.items if i.id in rows],
        }
        print(json.dumps(data))
        return
    _say(options, *_table(summary))
    if summary.failed:
        _say(options, f"logs of failed objects: {batch.failed}")
    _say(options, f"results: {batch.runs}; ledger: {ledger}")


def _table(summary: Summary) -> list[str]:
    """Return the counts as lines of a table."""
    lines = [f"{'status':16} {'objects':>8} {'seconds each':>13} {'E_color':>9} {'E_depth':>9}"]
    if summary.before:
        lines.append(f"{'finished before':16} {summary.before:8,}")
    for status in ("finished", "found", "failed"):
        count = summary.counts[status]
        if not count:
            continue
        line = f"{status:16} {count:8,} {summary.worker_seconds[status] / count:13.2f}"
        if status == "finished":
            mean = [summary.facts[name] / count for name in ("e_color", "e_depth")]
            line += f" {mean[0]:9.5f} {mean[1]:9.5f}"
        lines.append(line)
    ended = sum(summary.counts.values())
    if ended:
        each = summary.seconds / ended
        lines.append(f"{summary.seconds:,.1f} s in all, {each:.2f} s per object")
    return lines


def _say(options: BatchOptions, *lines: str) -> None:
    """Print lines for a person: standard output, or standard error when that is for a machine."""
    for line in lines:
        print(line, file=sys.stderr if options.json else sys.stdout, flush=True)
