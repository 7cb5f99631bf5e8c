"""Structure from motion with pycolmap: poses from photos, and points for known poses.

Conventions
-----------
* The result is an ordinary COLMAP model (``sparse/0``, or ``triangulated`` for known poses) in the
  work folder, read back by ``colmap_model``; what is finished there is not computed again if it
  was made from the same photos, settings and cameras (``sfm_folder``).
* COLMAP's world frame has no meaning: its scale is arbitrary and its up axis is not known.
* COLMAP runs in a process of its own (``colmap_process``), because its native code ends the
  process on errors of its own and can only be stopped with it. Its database is its
  own: COLMAP fails where anybody else has it open.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from gscomplete.errors import UserError
from gscomplete.util import jsonio
from splatcomplete_data.multiview.photos.colmap_model import image_names, read_colmap, read_points
from splatcomplete_data.multiview.photos.images import left_out_note, list_photos, photo_size
from splatcomplete_data.multiview.photos.lens import Lens
from splatcomplete_data.multiview.photos.posed import FEWEST_PHOTOS, PosedPhotos
from splatcomplete_data.multiview.sfm import folder as sfm_folder
from splatcomplete_data.multiview.sfm.pairs import can_be_listed, near_pairs
from splatcomplete_data.scan import PointCloud

Progress = Callable[[str, int, int], None]
"""Called with (stage, done, total)."""
Matching = Literal["auto", "exhaustive", "sequential"]
"""``exhaustive``: every pair. ``sequential``: neighbours in the order of names, for videos.
``auto``: for known poses near ones (``pairs``), else exhaustive up to 250 photos."""
LensModel = Literal["SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE"]

MOST_EXHAUSTIVE = 250
_ADVICE = (
    "Try more overlap between neighbouring photos (60 % and more), sharper photos, more texture "
    "around the object, a scene without motion, --sfm-lens OPENCV for wide lenses, or "
    "--sfm-lens-per-photo if zoom or camera changed"
)

_FEWEST_REGISTERED = 0.5
"""With a smaller share of photos registered the result is refused."""


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
    """Neighbours compared in sequential matching, and of known poses."""
    seed: int = 0
    """Seed of COLMAP's random sampling."""


def find_poses(
    images: Path,
    work: Path,
    settings: SfmSettings | None = None,
    progress: Progress | None = None,
    *,
    anew: bool = True,
) -> PosedPhotos:
    """Find the cameras of a folder of photos.

    Args:
        images: folder of photos.
        work: folder for the database and the model; created. A finished model in it is read.
        settings: knobs; None = defaults.
        progress: told about every stage.
        anew: clear the work folder and start anew where it was made from something else; else
            that is an error.

    Raises:
        UserError: pycolmap is missing, a photo cannot be read, too few photos register (the
            message says how many did and what to try), or the work folder does not fit.
    """
    settings = settings or SfmSettings()
    photos = {path.name: path for path in list_photos(images)}
    names = list(photos)
    shared = not settings.lens_per_photo and len({photo_size(p) for p in photos.values()}) == 1
    model = work / sfm_folder.POSES_MODEL
    registry = model / "images.bin"
    notes = _begin(work, registry, sfm_folder.made_from(photos, settings), anew)
    if not registry.is_file():
        groups = [{"names": names, "model": settings.lens, "params": "", "shared": shared}]
        request = _request(images, work, settings, groups, len(names))
        found = {"model": str(model), "poses": None, "enlarge": True}
        _run_colmap({**request, **found}, progress)
    registered = len(image_names(model)) if registry.is_file() else 0
    fewest = max(FEWEST_PHOTOS, round(_FEWEST_REGISTERED * len(names)))
    left_out = left_out_note(images)
    if registered < fewest:
        raise UserError(
            f"{images}: {registered} of {len(names)} photos registered, expected at least "
            f"{fewest}. {_ADVICE}{'; ' + left_out if left_out else ''}"
        )
    capture = read_colmap(model, images)
    note = f"structure from motion: {len(capture.photos)} of {len(names)} photos registered"
    lost = sorted(set(names) - {photo.path.name for photo in capture.photos})
    if lost:
        note += f" (not: {', '.join(lost)})"
    notes = (*notes, note, *([left_out] if left_out else []))
    return PosedPhotos(capture.photos, capture.points, "structure from motion", notes)


def triangulate(
    capture: PosedPhotos,
    work: Path,
    settings: SfmSettings | None = None,
    progress: Progress | None = None,
    *,
    anew: bool = True,
) -> tuple[PointCloud | None, tuple[str, ...]]:
    """Find the sparse cloud of a capture whose poses are known.

    Args:
        capture: photos with cameras.
        work: folder for the database and the model; a finished one in it is read.
        settings: knobs; None = defaults.
        progress: told about every stage.
        anew: as in ``find_poses``.

    Returns:
        The points, None when no features match; and notes.

    Raises:
        UserError: pycolmap is missing or fails, or the work folder does not fit.
    """
    settings = settings or SfmSettings()
    named = dict(zip(capture.names, capture.photos, strict=True))
    poses = {name: photo.camera_from_world.tolist() for name, photo in named.items()}
    cameras = {name: [jsonio.to_json(named[name].lens), pose] for name, pose in poses.items()}
    files = {name: photo.path for name, photo in named.items()}
    model = work / sfm_folder.POINTS_MODEL
    wanted = sfm_folder.made_from(files, settings, cameras)
    notes = _begin(work, model / "points3D.bin", wanted, anew)
    if not (model / "points3D.bin").is_file():
        lenses: dict[Lens, list[str]] = {}
        for name, photo in named.items():
            lenses.setdefault(photo.lens, []).append(name)
        groups = []
        for lens, names in lenses.items():
            kind, params = _colmap_lens(lens)
            groups.append({"names": names, "model": kind, "params": params, "shared": True})
        request = _request(capture.folder, work, settings, groups, len(named))
        found = {"model": str(model), "poses": poses, "enlarge": False}
        if settings.matching == "auto" and can_be_listed(named):
            found |= {"matching": "listed", "pairs": near_pairs(capture, settings.overlap)}
        _run_colmap({**request, **found}, progress)
    return read_points(model), notes


def has_pycolmap() -> bool:
    """Whether pycolmap is installed."""
    return importlib.util.find_spec("pycolmap") is not None


def _begin(work: Path, result: Path, wanted: dict[str, Any], anew: bool) -> tuple[str, ...]:
    """Make the work folder ready; return a note if it starts anew.

    Raises:
        UserError: there is something to compute and no pycolmap, the folder was made from
            something else and may not start anew, or it cannot be written.
    """
    others = ", ".join(sfm_folder.differences(work, wanted))
    if others and not anew:
        raise UserError(
            f"{work}: cannot resume, as it was made from other {others}; use --overwrite"
        )
    if not has_pycolmap() and (others or not result.is_file()):
        raise UserError(
            "structure from motion needs pycolmap, which is not installed here; install the extra "
            "gscomplete[data], or give --poses with a COLMAP model or a transforms.json"
        )
    sfm_folder.begin(work, wanted)
    if not others:
        return ()
    return (f"structure from motion starts again, as {work} was made from other {others}",)


def _request(
    images: Path, work: Path, settings: SfmSettings, groups: list[dict[str, Any]], total: int
) -> dict[str, Any]:
    """Return what ``colmap_process`` is asked for."""
    matching = settings.matching
    if matching == "auto":
        matching = "exhaustive" if total <= MOST_EXHAUSTIVE else "sequential"
    return {
        **dataclasses.asdict(settings),
        "matching": matching,
        "images": str(images),
        "work": str(work),
        "database": str(work / sfm_folder.DATABASE_FILE),
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


def _run_colmap(request: dict[str, Any], progress: Progress | None) -> dict[str, Any]:
    """Run ``colmap_process`` to its end and return its last answer.

    Raises:
        UserError: it failed; the message quotes the end of its log.
    """
    log = Path(request["work"]) / sfm_folder.LOG_FILE
    command = [sys.executable, "-m", "splatcomplete_data.multiview.sfm.colmap_process"]
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
            answer = _listen(process, progress)
        except BaseException:
            process.kill()
            raise
    if process.returncode != 0 or answer is None:
        lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        cause = lines[-1] if lines else f"exit code {process.returncode}"
        raise UserError(f"structure from motion: COLMAP failed: {cause} (all of it: {log})")
    return answer


def _listen(process: subprocess.Popen[bytes], progress: Progress | None) -> dict[str, Any] | None:
    """Pass progress on until the process ends; return its result, None if it gave none."""
    assert process.stdout is not None
    for line in process.stdout:
        message = json.loads(line)
        if "result" in message:
            return dict(message["result"])
        if progress is not None:
            progress(message["stage"], message["done"], message["total"])
    return None
