"""The work folder of structure from motion: what lies in it, and what that was made from.

Conventions
-----------
* ``made_from.json`` says what everything else in the folder was made from: the settings, the
  photos by name and content, and the cameras where these were given. It is written before COLMAP
  begins, and is the first to go when the folder is cleared: without it nothing there is used.
* Only what structure from motion writes is ever cleared.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gscomplete.errors import UserError
from gscomplete.util import jsonio
from gscomplete.util.digests import sha256_of

MADE_FROM_FILE = "made_from.json"
DATABASE_FILE = "database.db"
LOG_FILE = "colmap.log"
PAIRS_FILE = "pairs.txt"
POSES_MODEL = Path("sparse", "0")
POINTS_MODEL = Path("triangulated")
_WRITTEN = (
    MADE_FROM_FILE,
    DATABASE_FILE,
    *(f"{DATABASE_FILE}-{part}" for part in ("journal", "shm", "wal")),
    LOG_FILE,
    PAIRS_FILE,
    str(POSES_MODEL.parent),
    str(POINTS_MODEL),
    f"{POINTS_MODEL}.part",
    "models",
    "triangulation",
)


def made_from(
    photos: Mapping[str, Path], settings: Any, cameras: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return what decides the content of the work folder, as JSON values.

    Args:
        photos: files by name.
        settings: knobs, a dataclass.
        cameras: lens and pose of every photo, as JSON values; None = they are to be found.

    Raises:
        UserError: a photo cannot be read.
    """
    given = None
    if cameras is not None:
        given = hashlib.sha256(json.dumps(cameras, sort_keys=True).encode()).hexdigest()
    return {
        "settings": jsonio.to_json(settings),
        "photos": {name: sha256_of(path) for name, path in photos.items()},
        "cameras": given,
    }


def differences(work: Path, wanted: dict[str, Any]) -> list[str]:
    """Return which parts of what the folder was made from are others; none where it holds nothing.

    A folder that does not say what it was made from differs in all.
    """
    if not any((work / name).exists() for name in _WRITTEN):
        return []
    found: Any = None
    with contextlib.suppress(UserError):
        found = jsonio.read_json(work / MADE_FROM_FILE)
    if not isinstance(found, dict):
        found = {}
    return [part for part, value in wanted.items() if part not in found or found[part] != value]


def begin(work: Path, wanted: dict[str, Any]) -> None:
    """Make the folder ready for what is made from ``wanted``; what was made from else goes.

    Raises:
        UserError: the folder cannot be written.
    """
    try:
        if differences(work, wanted):
            _clear(work)
        work.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{work}: cannot prepare the folder: {error.strerror}") from error
    if not (work / MADE_FROM_FILE).is_file():
        jsonio.write_json(work / MADE_FROM_FILE, wanted)


def _clear(work: Path) -> None:
    """Remove what structure from motion wrote."""
    for name in _WRITTEN:
        path = work / name
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
