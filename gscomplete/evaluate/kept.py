"""Store measurements of completions, so that a long evaluation continues where it was stopped.

Conventions
-----------
* There is one JSON file per completion, ``FOLDER/METHOD/OBJECT.json``, with its row and, if one was
  drawn, its card.
* A file is used only if the bytes of all measured files, the settings and the code of this package
  are the same; otherwise the completion is measured again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gscomplete
from gscomplete.errors import UserError
from gscomplete.evaluate.rows import Row
from gscomplete.folders import OBJECT_FILE, RUN_FILE
from gscomplete.util import jsonio
from gscomplete.util.atomic import atomic_path
from gscomplete.util.digests import sha256_of

_MEASURED_FILES = (RUN_FILE, OBJECT_FILE, "*.ply")
"""Of a folder."""


@dataclass(frozen=True, slots=True)
class Kept:
    """A completion that was measured before."""

    row: Row
    card: dict[str, Any] | None
    """What a page says of it; None = none was drawn."""


class KeptResults:
    """What a folder holds for given settings."""

    def __init__(self, folder: Path, settings: Any) -> None:
        """Open the folder, which need not exist.

        Args:
            folder: where files are kept.
            settings: JSON values that decide rows and cards.
        """
        self._folder = folder
        self._made_with = [package_digest(), jsonio.to_json(settings)]

    def find(self, method: str, object_id: str, sources: Sequence[Path]) -> Kept | None:
        """Return the stored measurement of a completion; None = there is none that is still valid.

        Args:
            method: who completed.
            object_id: which object.
            sources: files, and folders of files, that are measured.
        """
        path = self._path(method, object_id)
        try:
            content = jsonio.read_json(path) if path.is_file() else {}
            if content.get("made_from") != self._made_from(sources):
                return None
            return Kept(jsonio.from_json(Row, content["row"], str(path)), content["card"])
        except (UserError, AttributeError, KeyError):  # damaged: measured again
            return None

    def add(self, method: str, object_id: str, sources: Sequence[Path], kept: Kept) -> None:
        """Keep a completion.

        Args:
            method: who completed.
            object_id: which object.
            sources: as for ``find``.
            kept: what was measured.

        Raises:
            UserError: the folder cannot be written.
        """
        path = self._path(method, object_id)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"{path.parent}: cannot create it ({error.strerror})") from error
        content = {
            "made_from": self._made_from(sources),
            "row": jsonio.to_json(kept.row),
            "card": kept.card,
        }
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(content), encoding="utf-8")

    def _path(self, method: str, object_id: str) -> Path:
        return self._folder / method / f"{object_id}.json"

    def _made_from(self, sources: Sequence[Path]) -> list[Any]:
        """Return what decides the row, as JSON values."""
        files = [path for source in sources for path in _files_of(source)]
        return [*self._made_with, [sha256_of(path) for path in files]]


def package_digest() -> str:
    """Return the digest of this package's code, in hexadecimal."""
    root = Path(gscomplete.__path__[0])
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _files_of(source: Path) -> list[Path]:
    if source.is_file():
        return [source]
    return sorted(path for pattern in _MEASURED_FILES for path in source.glob(pattern))
