"""Tables like the paper's 1 and 2: methods side by side, over all objects, by subset, by object.

Conventions
-----------
* A mean is over the objects for which the number is known; it is given with their count and its 95
  % bootstrap interval over objects. A failure on an object lowers a method's count, not its mean.
  So only means over the objects that all methods have are comparable; these form a group of their
  own (``compared_rows``).
* A column is left out if no row has its number.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

from gscomplete.evaluate.bootstrap import bootstrap_interval
from gscomplete.evaluate.rows import MEASURES, Measure, Row


@dataclass(frozen=True, slots=True)
class Mean:
    """A mean over objects."""

    value: float
    low: float
    high: float
    count: int


def compared_rows(rows: Sequence[Row]) -> list[Row]:
    """Keep the objects that every method has a row of."""
    methods = {row.method for row in rows}
    return [
        row
        for row in rows
        if {other.method for other in rows if other.object == row.object} == methods
    ]


def mean_of(rows: Sequence[Row], name: str) -> Mean | None:
    """Average a number over rows; None where no row has it."""
    found = [row.values.get(name) for row in rows]
    values = [value for value in found if value is not None]
    if not values:
        return None
    return Mean(sum(sorted(values)) / len(values), *bootstrap_interval(values), len(values))


def groups_of(rows: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    """Return all rows, those of objects that all methods have, and those of each subset."""
    subsets = sorted({row.subset for row in rows if row.subset is not None})
    groups = [("all", list(rows))]
    compared = compared_rows(rows)
    if 0 < len(compared) < len(rows):
        groups.append(("with every method", compared))
    if len(subsets) > 1:
        groups += [(name, [row for row in rows if row.subset == name]) for name in subsets]
    return groups


def methods_of(rows: Sequence[Row]) -> list[str]:
    """Return the methods in the order of their first rows."""
    return list(dict.fromkeys(row.method for row in rows))


def unavailable_of(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Return the measures that this machine cannot compute, with the reasons."""
    labels = {m.name: m.label for m in MEASURES}
    pairs = {(labels[name], why) for row in rows for name, why in row.unavailable.items()}
    return sorted(pairs)


def measures_of(rows: Sequence[Row]) -> list[Measure]:
    """Return the measures that at least one row has."""
    return [m for m in MEASURES if any(row.values.get(m.name) is not None for row in rows)]


def best_method(rows: Sequence[Row], measure: Measure) -> str | None:
    """Return the method with the best mean.

    None where fewer than two have one, or no object is common to all that have.
    """
    means, common = {}, {row.object for row in rows}
    for method in methods_of(rows):
        own = [row for row in rows if row.method == method]
        mean = mean_of(own, measure.name)
        if mean is not None:
            means[method] = mean.value
            common &= {row.object for row in own}
    if len(means) < 2 or not common:
        return None
    choose = min if measure.lower_is_better else max
    return choose(means, key=lambda method: means[method])


def markdown(rows: Sequence[Row], *, per_object: bool = False) -> str:
    """Write the means by method, over all objects and by subset, as Markdown tables.

    Args:
        rows: what was measured.
        per_object: append one line for every row.
    """
    measures = measures_of(rows)
    head = [f"{m.label} {'↓' if m.lower_is_better else '↑'}" for m in measures]
    lines = []
    for name, group in groups_of(rows):
        lines += [f"**{name}**", "", "| method | n | " + " | ".join(head) + " |"]
        lines.append("|---|---:|" + "---:|" * len(head))
        for method in methods_of(group):
            own = [row for row in group if row.method == method]
            cells = [_cell(own, group, m, method, "**{}**", " ({} to {})") for m in measures]
            lines.append(f"| {_plain(method)} | {len(own)} | " + " | ".join(cells) + " |")
        lines.append("")
    if per_object:
        lines += ["| object | subset | method | " + " | ".join(head) + " |"]
        lines.append("|---|---|---|" + "---:|" * len(head))
        for row in sorted(rows, key=lambda r: (r.subset or "", r.object)):
            cells = [_number(row.values.get(m.name), m) for m in measures]
            start = f"| {_plain(row.object)} | {row.subset or '-'} | {_plain(row.method)} | "
            lines.append(start + " | ".join(cells) + " |")
        lines.append("")
    return "\n".join(lines)


def latex(rows: Sequence[Row]) -> str:
    """Write the means as one LaTeX table (booktabs), a block by subset, the best in bold."""
    measures = measures_of(rows)
    arrows = [r"\downarrow" if m.lower_is_better else r"\uparrow" for m in measures]
    head = " & ".join(f"{m.latex} ${a}$" for m, a in zip(measures, arrows, strict=True))
    lines = [r"\begin{tabular}{lr" + "c" * len(measures) + "}", r"\toprule"]
    lines += [rf" & $n$ & {head} \\"]
    for name, group in groups_of(rows):
        columns = len(measures) + 2
        lines += [r"\midrule", rf"\multicolumn{{{columns}}}{{l}}{{\emph{{{name}}}}} \\"]
        for method in methods_of(group):
            own = [row for row in group if row.method == method]
            cells = [_cell(own, group, m, method, r"\textbf{{{}}}", "") for m in measures]
            cells = ["--" if cell == "-" else cell for cell in cells]
            lines.append(rf"{_escaped(method)} & {len(own)} & " + " & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def csv_text(rows: Sequence[Row]) -> str:
    """Write every row with every measure as CSV; what is not known is an empty field."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["method", "object", "subset", "seconds", *(m.name for m in MEASURES)])
    for row in rows:
        values = [row.values.get(m.name) for m in MEASURES]
        cells = ["" if v is None else repr(v) for v in (row.seconds, *values)]
        writer.writerow([row.method, row.object, row.subset or "", *cells])
    return out.getvalue()


def _cell(
    own: Sequence[Row], group: Sequence[Row], measure: Measure, method: str, bold: str, spread: str
) -> str:
    """Write a mean, with its interval if ``spread`` has a place for it; the best in bold."""
    mean = mean_of(own, measure.name)
    if mean is None:
        return "-"
    text = _number(mean.value, measure)
    if best_method(group, measure) == method:
        text = bold.format(text)
    if spread and mean.count > 1:
        low, high = _number(mean.low, measure), _number(mean.high, measure)
        text += spread.replace("{}", low, 1).replace("{}", high, 1)
    return text


def _number(value: float | None, measure: Measure) -> str:
    return "-" if value is None else f"{value:.{measure.digits}f}"


def _plain(text: str) -> str:
    """Keep a name from ending a Markdown cell."""
    return text.replace("|", r"\|").replace("\n", " ")


def _escaped(text: str) -> str:
    """Keep a name from meaning anything to LaTeX."""
    text = text.replace("\\", "/")
    for mark in "&%$#_{}":
        text = text.replace(mark, "\\" + mark)
    return text
