"""Progress bars of the commands, on standard error."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress

_TIME_WIDTH = 7
"""Of H:MM:SS."""
COUNT = "{task.completed:,.0f}/{task.total:,.0f}"


def progress_bar(
    title: str, *after: str, count: str | None = COUNT, transient: bool = False
) -> Progress:
    """Return a bar with the time taken and an ETA.

    Args:
        title: before the bar; ``{task.description}`` stands for a task's own.
        after: what follows the ETA, such as ``{task.fields[losses]}``.
        count: how many of how many; None = not shown.
        transient: whether the bar goes when it ends.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.progress import TimeRemainingColumn as Remaining
    from rich.table import Column

    counted = () if count is None else (TextColumn(count),)
    # On a narrow terminal, what follows the ETA is cut off, not the times.
    taken = TimeElapsedColumn(Column(no_wrap=True, min_width=_TIME_WIDTH))
    left = Remaining(table_column=Column(no_wrap=True, min_width=_TIME_WIDTH))
    columns = (TextColumn(title), BarColumn(), *counted, taken, TextColumn("ETA"), left)
    rest = map(TextColumn, after)
    return Progress(*columns, *rest, console=Console(file=sys.stderr), transient=transient)
