"""Rows of an experiment, saved to a file as they are measured, so that it can be resumed.

Conventions
-----------
* The file records what its rows were made with (seed, prior, settings). An experiment resumes only
  rows that were made with its own options, so a report never mixes rows of different options.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from gscomplete.errors import UserError
from gscomplete.util import jsonio
from gscomplete.util.atomic import atomic_path


class Results:
    """Rows by name, including those that an earlier run has saved."""

    def __init__(self, path: Path, made_with: dict[str, Any]) -> None:
        """Open a file of rows, or begin one.

        Args:
            path: the JSON file; its folder is created.
            made_with: what decides the rows' numbers; dataclasses become JSON values.

        Raises:
            UserError: the file's rows were made with something else, or it is no such file.
        """
        self.path = path
        self.rows: dict[str, Any] = {}
        self._made_with: dict[str, Any] = json.loads(json.dumps(jsonio.to_json(made_with)))
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            return
        content = jsonio.read_json(path)
        if not isinstance(content, dict) or not {"made_with", "rows"} <= set(content):
            raise UserError(f"{path}: expected made_with and rows, found neither; remove it")
        before = content["made_with"]
        for name in {**before, **self._made_with}:
            wanted, found = self._made_with.get(name), before.get(name)
            if found != wanted:
                where, wanted, found = _first_difference(name, wanted, found)
                raise UserError(
                    f"{path}: its rows were made with another {where}: expected {wanted}, found "
                    f"{found}; choose another --out"
                )
        self.rows = content["rows"]

    def save(self) -> None:
        """Write the rows."""
        content = {"made_with": self._made_with, "rows": self.rows}
        with atomic_path(self.path) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _first_difference(name: str, wanted: Any, found: Any) -> tuple[str, Any, Any]:
    """Return where two JSON values first differ, and what is there in each."""
    while isinstance(wanted, dict) and isinstance(found, dict):
        both = {**wanted, **found}
        key = next((key for key in both if wanted.get(key) != found.get(key)), None)
        if key is None:  # one of them says null where the other says nothing
            break
        name, wanted, found = f"{name}.{key}", wanted.get(key), found.get(key)
    return name, wanted, found
