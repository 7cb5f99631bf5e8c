"""Where MVDream's weights live, what is published, and how they are fetched.

Conventions
-----------
* ``gscomplete complete --prior mvdream`` looks in ``weights_folder()`` for a converted folder, a
  diffusers-style folder or the published file, in this order.
* A download comes from one named revision of the hub. Its length and SHA-256 must be those that
  the hub records for the file at that revision, its tensors exactly MVDream's.
* Both names of the revision and the licence were read in public source code and in the README of
  the original repository; the file itself was never seen by the authors of this package.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gscomplete.errors import UserError
from gscomplete.priors.latent.networks import require
from gscomplete.priors.latent.text import CACHE_VARIABLE, cache_home
from gscomplete.priors.mvdream.weights import MANIFEST_FILE, open_weights
from gscomplete.util.digests import sha256_of


@dataclass(frozen=True, slots=True)
class Published:
    """A file of weights on the hub."""

    repository: str
    revision: str
    filename: str
    licence: str
    bytes: int
    """About; from the number of values, in float32."""
    sha256: str | None = None
    """Digest to insist on; None = the one that the hub records for this revision."""


MVDREAM = Published(
    repository="MVDream/MVDream",
    revision="d14ac9d78c48c266005729f2d5633f6c265da467",
    filename="sd-v2.1-base-4view.pt",
    bytes=1_305_258_668 * 4,
    licence="OpenRAIL (use-based restrictions; read the model's page on the hub)",
)


def weights_folder() -> Path:
    """Return the folder where ``--prior mvdream`` looks."""
    return cache_home() / "weights" / "mvdream"


def find_mvdream(folder: Path | None = None) -> Path:
    """Return the weights in a folder, a path for ``open_weights``.

    Args:
        folder: where to look; None = the standard place.

    Raises:
        UserError: there are none; the message says what is needed and where to put it.
    """
    folder = folder or weights_folder()
    if (folder / MANIFEST_FILE).is_file() or (folder / "unet" / "config.json").is_file():
        return folder
    if (folder / MVDREAM.filename).is_file():
        return folder / MVDREAM.filename
    raise UserError(missing_message(folder))


def missing_message(folder: Path) -> str:
    """Return the one message that says which weights are missing and how to get them."""
    gib = MVDREAM.bytes / 2**30
    return (
        f"--prior mvdream: MVDream's weights are not in {folder}\n"
        f"  needed   {MVDREAM.filename} from {MVDREAM.repository} on the Hugging Face hub, about "
        f"{gib:.1f} GiB\n"
        f"  licence  {MVDREAM.licence}\n"
        "  fetch    gscomplete weights fetch mvdream   (on a machine with network access)\n"
        f"  or put   that file, or the folder of weights in diffusers' style, into {folder} "
        f"(elsewhere: --prior PATH, or set {CACHE_VARIABLE})"
    )


def fetch_mvdream(folder: Path) -> Path:
    """Download the published file into a folder and check it.

    Returns:
        The file.

    Raises:
        UserError: no network, not enough disk, or the file is not what the hub records.
    """
    hub = require("huggingface_hub")
    destination = folder / MVDREAM.filename
    size, sha256 = _recorded(hub, folder)
    if destination.is_file() and destination.stat().st_size == size:
        _check_digest(destination, sha256)
        return destination
    folder.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(folder).free
    if free < size * 1.02:
        raise UserError(
            f"{folder}: expected {size / 2**30:.1f} GiB of free space, found {free / 2**30:.1f}"
        )
    staging = folder / ".download"
    try:
        staged = Path(
            hub.hf_hub_download(
                MVDREAM.repository,
                MVDREAM.filename,
                revision=MVDREAM.revision,
                local_dir=staging,
            )
        )
    except Exception as error:
        raise _network_error(error, folder) from error
    _check_digest(staged, sha256)
    open_weights(staged)
    staged.replace(destination)
    shutil.rmtree(staging, ignore_errors=True)
    return destination


def _recorded(hub: Any, folder: Path) -> tuple[int, str]:
    """Return length and SHA-256 of the file as the hub records them for the pinned revision."""
    try:
        paths = hub.HfApi().get_paths_info(
            MVDREAM.repository, [MVDREAM.filename], revision=MVDREAM.revision
        )
    except Exception as error:
        raise _network_error(error, folder) from error
    if not paths or paths[0].lfs is None:
        raise UserError(
            f"{MVDREAM.repository}: {MVDREAM.filename}: expected a large file at revision "
            f"{MVDREAM.revision}, found none"
        )
    recorded = paths[0].lfs.sha256
    if MVDREAM.sha256 is not None and recorded != MVDREAM.sha256:
        raise UserError(
            f"{MVDREAM.repository}: {MVDREAM.filename}: expected SHA-256 {MVDREAM.sha256}, the hub "
            f"records {recorded}"
        )
    return int(paths[0].lfs.size), str(recorded)


def _check_digest(path: Path, expected: str) -> None:
    found = sha256_of(path)
    if found != expected:
        path.unlink()
        raise UserError(
            f"{path}: expected SHA-256 {expected}, found {found}; the download was damaged and has "
            "been removed, fetch it again"
        )


def _network_error(error: Exception, folder: Path) -> UserError:
    reason = str(error).strip().split("\n")[0][:200]
    return UserError(
        f"weights fetch mvdream: the hub cannot be used from here ({type(error).__name__}: "
        f"{reason}); fetch {MVDREAM.filename} of {MVDREAM.repository}, revision "
        f"{MVDREAM.revision}, on another machine and put it into {folder}"
    )
