"""Write the page: one HTML file that opens without a network.

Conventions
-----------
* Everything is inside the file: style, scripts, pictures and splats. Data are JSON in a script
  element that the browser does not run; splats are decoded when somebody wants to turn them.
* Texts of users (prompts, names, notes) only ever become text nodes.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import gscomplete
from gscomplete.evaluate.rows import MEASURES, Row
from gscomplete.evaluate.tables import (
    best_method,
    groups_of,
    mean_of,
    methods_of,
    unavailable_of,
)
from gscomplete.report.packed_splats import LARGEST, REACH, SMALLEST
from gscomplete.util.atomic import atomic_path
from gscomplete.util.file_names import shown_name
from gscomplete.util.jsonio import with_surrogates_escaped

_ASSETS = ("page.css", "viewer.js", "page.js")


def write_page(
    path: Path, title: str, rows: Sequence[Row], cards: Sequence[dict[str, Any]]
) -> None:
    """Write the page, replacing ``path`` in one step.

    Args:
        path: destination.
        title: heading.
        rows: what was measured; one card each.
        cards: as ``card_of`` gives them.

    Raises:
        UserError: the folder cannot be written.
    """
    data = {
        "title": title,
        "version": gscomplete.__version__,
        "measures": [
            {"name": m.name, "label": m.label, "lower": m.lower_is_better, "digits": m.digits}
            for m in MEASURES
            if any(row.values.get(m.name) is not None for row in rows)
        ],
        "means": _means(rows),
        "unavailable": unavailable_of(rows),
        "packing": {"reach": REACH, "smallest": SMALLEST, "largest": LARGEST},
        **_with_shared_inputs(cards),
    }
    style, viewer, script = (asset(name) for name in _ASSETS)
    text = "\n".join(
        (
            '<!doctype html><html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width">',
            '<link rel="icon" href="data:,">',
            f"<title>{escaped(title)}</title><style>{style}</style></head><body>",
            f'<script id="data" type="application/json">{embedded(data)}</script>',
            f"<script>{viewer}</script><script>{script}</script></body></html>",
            "",
        )
    )
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _with_shared_inputs(cards: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the inputs of all cards, each once, and the cards, which refer to them by index."""
    inputs: list[Any] = []
    for card in cards:
        if card["input"] not in inputs:
            inputs.append(card["input"])
    numbered = [card | {"input": inputs.index(card["input"])} for card in cards]
    return {"inputs": inputs, "cards": numbered}


def _means(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the means by subset and method, with intervals and the best one marked."""
    found = []
    for group, members in groups_of(rows):
        for method in methods_of(members):
            own = [row for row in members if row.method == method]
            cells: dict[str, Any] = {}
            for measure in MEASURES:
                mean = mean_of(own, measure.name)
                if mean is not None:
                    cells[measure.name] = {
                        "value": mean.value,
                        "low": mean.low,
                        "high": mean.high,
                        "best": best_method(members, measure) == method,
                    }
            found.append({"group": group, "method": method, "count": len(own), "cells": cells})
    return found


def embedded(data: Any) -> str:
    """Write JSON that cannot end the element it stands in.

    Args:
        data: JSON values.
    """
    text = json.dumps(data, ensure_ascii=False, allow_nan=False)
    return with_surrogates_escaped(text).replace("<", "\\u003c")


def escaped(text: str) -> str:
    """Write text that is no markup and that UTF-8 can hold.

    Args:
        text: anything.
    """
    return shown_name(text).replace("&", "&amp;").replace("<", "&lt;")


def asset(name: str) -> str:
    """Return a style or script of this folder.

    Args:
        name: of the file.
    """
    return (resources.files("gscomplete.report") / name).read_text(encoding="utf-8")
