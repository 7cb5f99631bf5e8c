"""A job without networks, tasks for workers, and stores in memory."""

import hashlib
import json
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gscomplete.batch.manifest import Item
from gscomplete.errors import UserError


@dataclass(frozen=True)
class ToyJob:
    """Writes the input's digest; counts in ``notes`` how often each object was made."""

    notes: Path
    kills: tuple[str, ...] = ()
    """Objects whose first worker kills itself in the middle."""
    stops: bool = False
    """Whether objects are interrupted in the middle."""

    def make(self, item: Item, source: Path, out: Path, *, resume: bool) -> dict[str, Any]:
        files = [source] if source.is_file() else [source / "partial.ply"]
        content = files[0].read_bytes()
        if content == b"bad":
            raise UserError(f"{files[0]}: it is bad")
        if content == b"bug":
            raise ZeroDivisionError("a bug")
        with (self.notes / item.id).open("a") as notes:
            notes.write("resumed\n" if resume else "begun\n")
        out.mkdir(exist_ok=resume)
        (out / "run.json").write_text(json.dumps({"input": {"path": str(files[0])}}))
        if item.id in self.kills and not resume:
            os.kill(os.getpid(), signal.SIGKILL)
        if self.stops:
            raise KeyboardInterrupt
        (out / "completed.ply").write_bytes(hashlib.sha256(content).digest())
        return {"new_splats": len(content)}


def notes_of(folder: Path) -> dict[str, list[str]]:
    return {path.name: path.read_text().split() for path in folder.iterdir()}


def square(number: int) -> int:
    return number * number


def process_and_threads(number: int) -> tuple[int, str | None]:
    time.sleep(0.05)
    return os.getpid(), os.environ.get("OMP_NUM_THREADS")


def die_unless_noted(path: Path) -> str:
    """Kill the worker that is first given the task, and none after it."""
    if not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return path.name


def die(number: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return number


def fail(number: int) -> int:
    raise UserError("nothing can be done")


def wait_for_a_signal(folder: Path) -> None:
    try:
        (folder / str(os.getpid())).touch()
        time.sleep(60)
    except KeyboardInterrupt:
        (folder / "checkpoint").touch()
        raise


def allocate(gib: int) -> int:
    return len(bytearray(gib * 2**30))
