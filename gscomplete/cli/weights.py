"""``gscomplete weights``: list, fetch and convert the weights of priors.

Conventions
-----------
* ``list`` touches no network and exits 0 whether or not weights are there, 1 if those that are
  there are damaged; ``--verify`` compares converted files with their digests too.
* ``fetch`` is the only part of the package that uses a network.
"""

from __future__ import annotations

import importlib.util
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from gscomplete.errors import UserError


@dataclass(frozen=True)
class ListOptions:
    """List the weights of each prior that are on this machine, and whether they are ready."""

    verify: bool = False
    """Also read converted files completely and compare them with their digests."""
    json: bool = False
    """Print one JSON object instead of text."""


@dataclass(frozen=True)
class FetchOptions:
    """Download the published weights of a prior (needs a network)."""

    prior: Annotated[Literal["mvdream"], tyro.conf.Positional]
    """Which prior."""
    out: Path | None = None
    """Folder to write to; None = the one that --prior mvdream searches."""


@dataclass(frozen=True)
class ConvertOptions:
    """Convert MVDream's weights to a folder of safetensors files, optionally at half the size."""

    source: Annotated[Path, tyro.conf.Positional]
    """The published .pt file, or a diffusers-style folder."""
    out: Annotated[Path, tyro.conf.Positional]
    """Folder to create."""
    storage: Literal["keep", "float16"] = "keep"
    """keep: the numbers of the file, bit for bit. float16: half the size of float32."""


Action = (
    Annotated[ListOptions, tyro.conf.subcommand("list")]
    | Annotated[FetchOptions, tyro.conf.subcommand("fetch")]
    | Annotated[ConvertOptions, tyro.conf.subcommand("convert")]
)


@dataclass(frozen=True)
class WeightsOptions:
    """List, fetch and convert the weights of priors."""

    action: tyro.conf.OmitSubcommandPrefixes[Action]


def run(options: WeightsOptions) -> int:
    """Do what was asked; return the exit code."""
    if isinstance(options.action, FetchOptions):
        return _fetch(options.action)
    if isinstance(options.action, ConvertOptions):
        return _convert(options.action)
    return _list(options.action)


def _fetch(options: FetchOptions) -> int:
    from gscomplete.priors.mvdream.store import MVDREAM, fetch_mvdream, weights_folder

    folder = options.out or weights_folder()
    print(f"fetching {MVDREAM.filename} ({MVDREAM.bytes / 2**30:.1f} GiB) into {folder}")
    print(f"licence: {MVDREAM.licence}")
    path = fetch_mvdream(folder)
    print(f"checked: {path}")
    return 0


def _convert(options: ConvertOptions) -> int:
    from gscomplete.priors.mvdream.convert import convert

    weights = convert(options.source, options.out, options.storage)
    total = sum(path.stat().st_size for path in weights.files)
    print(f"written: {options.out} ({total / 2**30:.2f} GiB in {len(weights.files)} files)")
    return 0


def _list(options: ListOptions) -> int:
    found = [_embedded(), _mvdream(options.verify)]
    damaged = any(entry["state"] == "damaged" for entry in found)
    if options.json:
        print(json.dumps({"ok": not damaged, "priors": found}, indent=2))
        return int(damaged)
    for entry in found:
        print(f"{entry['prior']:9} {entry['state']:8} {entry['note']}")
    return int(damaged)


def _embedded() -> dict[str, Any]:
    from gscomplete.priors.embedded.weights import packaged_weights

    folder = packaged_weights()
    size = sum(path.stat().st_size for path in folder.glob("*.safetensors"))
    return _entry("embedded", "ready", folder, f"ships with the package, {size / 2**20:.1f} MiB")


def _mvdream(verify: bool) -> dict[str, Any]:
    from gscomplete.priors.mvdream.convert import verify_digests
    from gscomplete.priors.mvdream.store import find_mvdream, weights_folder
    from gscomplete.priors.mvdream.weights import open_weights

    try:
        path = find_mvdream()
    except UserError as error:
        return _entry("mvdream", "missing", weights_folder(), str(error))
    for package in ("diffusers", "transformers"):
        if importlib.util.find_spec(package) is None:
            note = f"{path}: not checked: that needs the package {package} (gscomplete[mvdream])"
            return _entry("mvdream", "found", path, note)
    try:
        weights = open_weights(path)
        if verify and weights.layout == "converted":
            verify_digests(path)
    except UserError as error:
        return _entry("mvdream", "damaged", path, str(error))
    size = sum(file.stat().st_size for file in weights.files)
    note = f"{path} ({weights.layout}, {size / 2**30:.2f} GiB)"
    return _entry("mvdream", "ready", path, note)


def _entry(prior: str, state: str, path: Path, note: str) -> dict[str, Any]:
    return {"prior": prior, "state": state, "path": path.as_posix(), "note": note}
