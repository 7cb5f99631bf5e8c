"""The process that COLMAP runs in: ``python -m splatcomplete_data.multiview.sfm.colmap_process``.

Conventions
-----------
* Standard input: one JSON object, the request of ``structure_from_motion``. Standard output: one
  JSON object a line, either {"stage", "done", "total"} or, at the end, {"result": {"registered"}}.
  COLMAP's own log goes to standard error.
* Nobody but this process opens the database. COLMAP does not wait for a locked one: it fails with
  "No registered database factory succeeded". Progress is counted over one connection, opened
  before COLMAP's own and closed after them, so that opening and closing it locks nobody out.
* The model's folder appears whole or not at all.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from splatcomplete_data.multiview.sfm.folder import PAIRS_FILE

_POLL_S = 0.5


def main() -> int:
    """Do what standard input asks for; return the exit code."""
    threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()
    request = json.load(sys.stdin)
    # COLMAP's libraries write to the process's standard output, too: only ours may reach it.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    pycolmap.logging.minloglevel = pycolmap.logging.WARNING.value
    reconstruct = _map if request["poses"] is None else _triangulate

    def say(**message: Any) -> None:
        answers.write(json.dumps(message) + "\n")
        answers.flush()

    store = pycolmap.Database.open(request["database"])
    with _counted("features", request["total"], store.num_images, say):
        _extract(request)
    pairs = _pairs(request)
    with _counted("pairs", pairs, store.num_verified_image_pairs, say):
        _match(request)
    store.close()
    model = reconstruct(request, say)
    registered = 0 if model is None else model.num_reg_images()
    if model is not None:
        _publish(model, Path(request["model"]))
    say(result={"registered": registered})
    return 0


def _end_with_parent(parent: int) -> None:
    """End this process after its parent: a killed command leaves no work behind."""
    while os.getppid() == parent:
        time.sleep(_POLL_S)
    os._exit(1)


@contextlib.contextmanager
def _counted(stage: str, total: int, count: Callable[[], int], say: Any) -> Iterator[None]:
    """Tell the progress of a stage while it runs, as ``count`` gives it."""
    finished = threading.Event()

    def tell() -> None:
        say(stage=stage, done=0, total=total)
        while not finished.wait(_POLL_S):
            say(stage=stage, done=min(count(), total), total=total)

    teller = threading.Thread(target=tell)
    teller.start()
    try:
        yield
    finally:
        finished.set()
        teller.join()


def _extract(request: dict[str, Any]) -> None:
    """Extract SIFT features; photos that the database holds already are passed over."""
    extraction = pycolmap.FeatureExtractionOptions(max_image_size=request["max_image_px"])
    extraction.sift.max_num_features = request["max_features"]
    extraction.sift.first_octave = -1 if request["enlarge"] else 0
    for group in request["groups"]:
        reader = pycolmap.ImageReaderOptions(camera_model=group["model"])
        reader.camera_params = group["params"]
        mode = pycolmap.CameraMode.SINGLE if group["shared"] else pycolmap.CameraMode.PER_IMAGE
        pycolmap.extract_features(
            request["database"],
            request["images"],
            image_names=group["names"],
            camera_mode=mode,
            reader_options=reader,
            extraction_options=extraction,
        )


def _pairs(request: dict[str, Any]) -> int:
    """Return how many pairs of photos are compared, at most."""
    total = int(request["total"])
    if request["matching"] == "listed":
        return len(request["pairs"])
    if request["matching"] == "exhaustive":
        return total * (total - 1) // 2
    return total * int(request["overlap"])


def _match(request: dict[str, Any]) -> None:
    """Match features and check the geometry of every pair."""
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = request["seed"]
    if request["matching"] == "listed":
        names = Path(request["work"]) / PAIRS_FILE
        with names.open("w", encoding="utf-8") as file:
            file.writelines(f"{one} {other}\n" for one, other in request["pairs"])
        pycolmap.match_image_pairs(
            request["database"],
            pairing_options=pycolmap.ImportedPairingOptions(match_list_path=names),
            verification_options=verification,
        )
        return
    if request["matching"] == "exhaustive":
        pycolmap.match_exhaustive(request["database"], verification_options=verification)
        return
    pycolmap.match_sequential(
        request["database"],
        pairing_options=pycolmap.SequentialPairingOptions(overlap=request["overlap"]),
        verification_options=verification,
    )


def _map(request: dict[str, Any], say: Any) -> Any | None:
    """Find poses and points; return the model with most photos, None without any."""
    models = Path(request["work"]) / "models"
    shutil.rmtree(models, ignore_errors=True)
    models.mkdir()
    placed = 2

    def one_more() -> None:
        nonlocal placed
        placed += 1
        say(stage="cameras", done=placed, total=request["total"])

    say(stage="cameras", done=0, total=request["total"])
    found = pycolmap.incremental_mapping(
        request["database"],
        request["images"],
        models,
        options=pycolmap.IncrementalPipelineOptions(random_seed=request["seed"]),
        next_image_callback=one_more,
    )
    shutil.rmtree(models, ignore_errors=True)
    return max(found.values(), key=lambda model: model.num_reg_images(), default=None)


def _triangulate(request: dict[str, Any], say: Any) -> Any:
    """Find points for the request's poses."""
    say(stage="points", done=0, total=1)
    known = pycolmap.Reconstruction()
    store = pycolmap.Database.open(request["database"])
    for camera in store.read_all_cameras():
        known.add_camera_with_trivial_rig(camera)
    for stored in store.read_all_images():
        pose = request["poses"].get(stored.name)
        if pose is None:
            continue
        keypoints = np.asarray(store.read_keypoints(stored.image_id), np.float64)[:, :2]
        image = pycolmap.Image(
            name=stored.name,
            keypoints=keypoints,
            camera_id=stored.camera_id,
            image_id=stored.image_id,
        )
        known.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.array(pose)[:3]))
    store.close()
    out = Path(request["work"]) / "triangulation"
    out.mkdir(exist_ok=True)
    model = pycolmap.triangulate_points(
        known,
        request["database"],
        request["images"],
        out,
        options=pycolmap.IncrementalPipelineOptions(random_seed=request["seed"]),
    )
    shutil.rmtree(out, ignore_errors=True)
    return model


def _publish(model: Any, folder: Path) -> None:
    """Write a model so that it is there whole or not at all."""
    temporary = folder.with_name(folder.name + ".part")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir(parents=True)
    model.write(temporary)
    shutil.rmtree(folder, ignore_errors=True)
    temporary.rename(folder)


if __name__ == "__main__":
    sys.exit(main())
