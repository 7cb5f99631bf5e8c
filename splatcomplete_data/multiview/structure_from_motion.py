"""Structure from motion with pycolmap: poses from photos, and points for known poses.

Conventions
-----------
* The result is an ordinary COLMAP model (``sparse/0``, or ``triangulated`` for known poses) in the
  work folder, read back by ``colmap_model``; what is finished there is not computed again.
* COLMAP's world frame has no meaning: its scale is arbitrary and its up axis is not known.
* COLMAP runs in a process of its own (``colmap_process``), because its native code ends the whole
  process on errors of its own and can only be stopped with it, and because its SQLite and Python's
  must not have one database open in one process.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
import json
import selectors
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from PIL import Image, UnidentifiedImageError

from gscomplete.errors import UserError
from splatcomplete_data.multiview.colmap_model import read_colmap, read_points
from splatcomplete_data.multiview.images import list_photos
from splatcomplete_data.multiview.lens import Lens
from splatcomplete_data.multiview.posed import FEWEST_PHOTOS, PosedPhotos
from splatcomplete_data.scan import PointCloud

Progress = Callable[[str, int, int], None]
"""Called with (stage, done, total)."""
Matching = Literal["auto", "exhaustive", "sequential"]
"""``exhaustive``: every pair. ``sequential``: neighbours in the order of names, for videos.
``auto``: exhaustive up to 250 photos."""
LensModel = Literal["SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE"]

MOST_EXHAUSTIVE = 250
DATABASE_FILE = "database.db"
LOG_FILE = "colmap.log"
_POLL_S = 0.5
_ADVICE = (
    "Try more overlap between neighbouring photos (60 % and more), sharper photos, more texture "
    "around the object, nothing that moves, --sfm-lens OPENCV for wide lenses, or "
    "--sfm-lens-per-photo if zoom or camera changed"
)


@dataclass(frozen=True, slots=True)
class SfmSettings:
    """Knobs of structure from motion."""

    max_image_px: int = 1200
    """Photos are scaled to this longest side to find features."""
    max_features: int = 4096
    """SIFT features per photo."""
    lens: LensModel = "OPENCV"
    """Lens model that is estimated."""
    lens_per_photo: bool = False
    """Estimate a lens for every photo; else photos of one size share one: one phone, no zoom."""
    matching: Matching = "auto"
    """Which pairs of photos are compared."""
    overlap: int = 12
    """Neighbours compared in sequential matching."""
    fewest_registered: float = 0.5
    """With a smaller share of photos registered the result is refused."""
    seed: int = 0
    """Seed of COLMAP's random sampling."""


def find_poses(
    images: Path,
    work: Path,
    settings: SfmSettings | None = None,
    progress: Progress | None = None,
) -> PosedPhotos:
    """Find the cameras of a folder of photos.

    Args:
        images: folder of photos.
        work: folder for the database and the model; created. A finished model in it is read.
        settings: knobs; None = defaults.
        progress: told about every stage.

    Raises:
        UserError: pycolmap is missing, a photo cannot be read, or too few photos register; the
            message says how many did and what to try.
    """
    settings = settings or SfmSettings()
    names = [path.name for path in list_photos(images)]
    model = work / "sparse" / "0"
    if not (model / "images.bin").is_file():
        shared = not settings.lens_per_photo and _one_size(images, names)
        groups = [{"names": names, "model": settings.lens, "params": "", "shared": shared}]
        request = _request(images, work, settings, groups, len(names))
        answer = _run_colmap({**request, "model": str(model), "poses": None}, progress)
        registered = int(answer["registered"])
        fewest = max(FEWEST_PHOTOS, round(settings.fewest_registered * len(names)))
        if registered < fewest:
            raise UserError(
                f"{images}: {registered} of {len(names)} photos registered, expected at least "
                f"{fewest}. {_ADVICE}"
            )
    capture = read_colmap(model, images)
    note = f"structure from motion: {len(capture.photos)} of {len(names)} photos registered"
    lost = sorted(set(names) - {photo.path.name for photo in capture.photos})
    if lost:
        note += f" (not: {', '.join(lost)})"
    return PosedPhotos(capture.photos, capture.points, "structure from motion", (note,))


def triangulate(
    capture: PosedPhotos,
    work: Path,
    settings: SfmSettings | None = None,
    progress: Progress | None = None,
) -> PointCloud | None:
    """Find the sparse cloud of a capture whose poses are known.

    Args:
        capture: photos of one folder, with cameras.
        work: folder for the database and the model; a finished one in it is read.
        settings: knobs; None = defaults.
        progress: told about every stage.

    Returns:
        The points; None when no features match.

    Raises:
        UserError: pycolmap is missing or fails.
    """
    settings = settings or SfmSettings()
    model = work / "triangulated"
    if not (model / "points3D.bin").is_file():
        lenses: dict[Lens, list[str]] = {}
        for photo in capture.photos:
            lenses.setdefault(photo.lens, []).append(photo.path.name)
        groups = []
        for lens, names in lenses.items():
            name, params = _colmap_lens(lens)
            groups.append({"names": names, "model": name, "params": params, "shared": True})
        poses = {photo.path.name: photo.camera_from_world.tolist() for photo in capture.photos}
        folder = capture.photos[0].path.parent
        request = _request(folder, work, settings, groups, len(capture.photos))
        _run_colmap({**request, "model": str(model), "poses": poses}, progress)
    return read_points(model)


def has_pycolmap() -> bool:
    """Whether pycolmap is installed."""
    return importlib.util.find_spec("pycolmap") is not None


def _request(
    images: Path, work: Path, settings: SfmSettings, groups: list[dict[str, Any]], total: int
) -> dict[str, Any]:
    """Return what ``colmap_process`` is asked for, and create the work folder."""
    if not has_pycolmap():
        raise UserError(
            "structure from motion needs pycolmap, which is not installed here; install the extra "
            "gscomplete[data], or give --poses with a COLMAP model or a transforms.json"
        )
    try:
        work.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{work}: cannot create the folder: {error.strerror}") from error
    matching = settings.matching
    if matching == "auto":
        matching = "exhaustive" if total <= MOST_EXHAUSTIVE else "sequential"
    return {
        **dataclasses.asdict(settings),
        "matching": matching,
        "images": str(images),
        "work": str(work),
        "database": str(work / DATABASE_FILE),
        "groups": groups,
        "total": total,
    }


def _colmap_lens(lens: Lens) -> tuple[str, str]:
    """Return COLMAP's camera model and parameters of a lens."""
    start = (*lens.focal_px, *lens.center_px)
    if lens.kind == "fisheye":
        return "OPENCV_FISHEYE", ",".join(map(repr, (*start, *lens.radial[:4])))
    numbers = (*start, *lens.radial[:2], *lens.tangential, *lens.radial[2:])
    return "FULL_OPENCV", ",".join(map(repr, numbers))


def _one_size(images: Path, names: list[str]) -> bool:
    """Whether all photos have one size.

    Raises:
        UserError: a photo cannot be read.
    """
    sizes = set()
    for name in names:
        try:
            with Image.open(images / name) as image:
                sizes.add(image.size)
        except (OSError, UnidentifiedImageError) as error:
            raise UserError(f"{images / name}: cannot read it as a picture ({error})") from error
    return len(sizes) == 1


def _run_colmap(request: dict[str, Any], progress: Progress | None) -> dict[str, Any]:
    """Run ``colmap_process`` to its end and return its last answer.

    Raises:
        UserError: it failed; the message quotes the end of its log.
    """
    log = Path(request["work"]) / LOG_FILE
    command = [sys.executable, "-m", "splatcomplete_data.multiview.colmap_process"]
    with (
        log.open("wb") as errors,
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors
        ) as process,
    ):
        try:
            assert process.stdin is not None
            with contextlib.suppress(BrokenPipeError):
                process.stdin.write(json.dumps(request).encode())
                process.stdin.close()
            answer = _listen(process, request, progress)
        except BaseException:
            process.kill()
            raise
    if process.returncode != 0 or answer is None:
        lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        cause = lines[-1] if lines else f"exit code {process.returncode}"
        raise UserError(f"structure from motion: COLMAP failed: {cause} (all of it: {log})")
    return answer


def _listen(
    process: subprocess.Popen[bytes], request: dict[str, Any], progress: Progress | None
) -> dict[str, Any] | None:
    """Pass progress on until the process ends; return its result, None if it gave none."""
    stage: dict[str, Any] = {}
    assert process.stdout is not None
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        while True:
            if selector.select(_POLL_S):
                line = process.stdout.readline()
                if not line:
                    return None
                message = json.loads(line)
                if "result" in message:
                    return dict(message["result"])
                stage = message
            if progress is None or not stage:
                continue
            done = stage.get("done")
            if done is None:
                done = _rows(Path(request["database"]), stage["table"])
            progress(stage["stage"], min(done, stage["total"]), stage["total"])


def _rows(database: Path, table: str) -> int:
    """Return how many rows a table of COLMAP's database has; 0 while it cannot be read."""
    with contextlib.suppress(sqlite3.Error):
        connection = sqlite3.connect(
            f"{database.resolve().as_uri()}?mode=ro", uri=True, timeout=0.1
        )
        try:
            return int(connection.execute(f"SELECT COUNT(*) FROM {table}").fetchone()[0])
        finally:
            connection.close()
    return 0
