"""MVDream's weights of any layout to our own: three safetensors files and a manifest.

Conventions
-----------
* Tensors are stored under the names of the models built here (layout (c) of ``weights``); the
  part of the text tower that is never used is left out.
* ``keep`` keeps the file's numbers bit for bit; ``float16`` halves float32 files.
* A folder appears under its name only when it is complete.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any, Literal

import torch
from safetensors.torch import save_file

from gscomplete.errors import UserError
from gscomplete.priors.mvdream.weights import (
    COMPONENTS,
    MANIFEST_FILE,
    MANIFEST_SCHEMA,
    MANIFEST_VERSION,
    Weights,
    open_weights,
    stored_name,
)
from gscomplete.util.digests import sha256_of
from gscomplete.util.jsonio import read_json, to_json, write_json

Storage = Literal["keep", "float16"]


def convert(source: Path, out: Path, storage: Storage = "keep") -> Weights:
    """Convert weights to a folder of our layout.

    Args:
        source: weights of any layout.
        out: folder to create.
        storage: precision of the files.

    Returns:
        The converted weights, opened and checked.

    Raises:
        UserError: the source is not MVDream, or the folder exists or cannot be written.
    """
    if out.exists():
        raise UserError(f"{out}: expected a folder that does not exist yet, found one")
    weights = open_weights(source)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    except OSError as error:
        raise UserError(f"{out}: cannot create it: {error.strerror}") from error
    try:
        files = {name: _write(weights, name, staging, storage) for name in COMPONENTS}
        manifest = {
            "schema": MANIFEST_SCHEMA,
            "version": MANIFEST_VERSION,
            "config": to_json(weights.config),
            "storage": storage,
            "files": files,
            "source": {
                "name": source.name,
                "layout": weights.layout,
                "fingerprint": weights.fingerprint(),
            },
        }
        write_json(staging / MANIFEST_FILE, manifest)
        staging.chmod(0o755)
        staging.rename(out)
    except OSError as error:
        raise UserError(f"{out}: cannot write it: {error.strerror}") from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return open_weights(out)


def verify_digests(folder: Path) -> None:
    """Read a converted folder's files whole and compare them with their manifest.

    Raises:
        UserError: a file is missing or differs, or the manifest does not name it.
    """
    manifest = read_json(folder / MANIFEST_FILE)
    for name in COMPONENTS:
        path = folder / f"{name}.safetensors"
        try:
            expected = manifest["files"][name]["sha256"]
        except (KeyError, TypeError) as error:
            place = folder / MANIFEST_FILE
            raise UserError(
                f"{place}: files.{name}.sha256: expected a digest, found none"
            ) from error
        found = sha256_of(path) if path.is_file() else "no file"
        if found != expected:
            raise UserError(f"{path}: sha256: expected {expected}, found {found}")


def _write(weights: Weights, name: str, folder: Path, storage: Storage) -> dict[str, Any]:
    """Write one network; return its entry in the manifest."""
    state = {}
    for ours, tensor in weights.parts[name].state().items():
        if storage == "float16" and tensor.is_floating_point():
            tensor = tensor.to(torch.float16)
        # clone: safetensors refuses tensors that share memory (thirds of one stacked matrix)
        state[stored_name(ours)] = tensor.clone().contiguous()
    path = folder / f"{name}.safetensors"
    save_file(state, path)
    return {"name": path.name, "bytes": path.stat().st_size, "sha256": sha256_of(path)}
