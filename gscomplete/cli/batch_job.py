"""What a worker of ``gscomplete batch`` does: complete objects with a prior that stays loaded.

Conventions
-----------
* Prior and compiled kernels are loaded once per process, embeddings of prompts are kept on the disk
  by the priors that have some.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gscomplete.batch.manifest import FieldKind, Item
from gscomplete.batch.work import SetupError
from gscomplete.cli.complete_options import CompleteOptions, HowToComplete
from gscomplete.errors import UserError
from gscomplete.priors.latent.settings import LatentPriorSettings
from gscomplete.util import jsonio
from gscomplete.util.digests import sha256_of

if TYPE_CHECKING:
    import torch

    from gscomplete.priors.base import Prior

ITEM_FIELDS: dict[str, FieldKind] = {
    "prompt": str,
    "negative_prompt": str,
    "up": str,
    "view": str,
    "range": float,
    "center": str,
    "object_size": float,
    "mirror": str,
    "seed": int,
}
"""Options that a manifest may give to a single object."""
_NAMES = {"object_size": "size"}
"""Of fields that are called otherwise in Python."""
_DECIDES_NOTHING = ("device", "checkpoint_every")


@dataclass(frozen=True, slots=True)
class CompleteJob:
    """A ``gscomplete.batch.work.Job``."""

    options: HowToComplete

    def make(self, item: Item, source: Path, out: Path, *, resume: bool) -> dict[str, Any]:
        """Complete an object; see ``gscomplete.batch.work.Job``."""
        import torch

        from gscomplete.cli.request import request_of, settings_of
        from gscomplete.completion.run_folder import execute, prepare
        from gscomplete.folders import object_folder_of

        try:
            prior, device = _warm_prior(
                self.options.prior, self.options.device, self.options.diffusion
            )
            settings_of(self.options, prior)
        except UserError as error:
            raise SetupError(str(error)) from error
        shared = {
            field.name: getattr(self.options, field.name)
            for field in dataclasses.fields(HowToComplete)
        }
        if object_folder_of(source) is not None:
            shared["prompt"] = None  # the folder has one; the batch's is for objects without
        own = {_NAMES.get(name, name): value for name, value in item.options.items()}
        options = CompleteOptions(**(shared | own), partial=source, out=out, resume=resume)
        try:
            job = prepare(request_of(options, prior), prior, device)
            content = execute(job, lambda report: None)
        except torch.OutOfMemoryError as error:
            raise UserError(
                "the GPU ran out of memory (give a smaller --diffusion.memory)"
            ) from error
        result = content["result"]
        return {
            "new_splats": result["new_splats"],
            "e_color": result["metrics"]["all_views"]["color"],
            "e_depth": result["metrics"]["all_views"]["depth"],
        }


def identity_of(options: HowToComplete) -> dict[str, Any]:
    """Return what decides the results of a batch besides the input, as JSON values.

    Raises:
        UserError: the prior's weights are missing.
    """
    asked = {
        field.name: jsonio.to_json(getattr(options, field.name))
        for field in dataclasses.fields(HowToComplete)
        if field.name not in _DECIDES_NOTHING
    }
    return asked | {"weights": _weights_digest(options.prior)}


def _weights_digest(prior: str) -> str:
    """Return a digest of a prior's files; the name of a prior that has none.

    Raises:
        UserError: the files are missing.
    """
    if prior == "embedded":
        package = importlib.import_module("gscomplete.priors.embedded")
        path = Path(str(package.__file__)).with_name("weights")
    elif prior == "mvdream":
        from gscomplete.priors.mvdream.store import find_mvdream

        path = find_mvdream()
    else:
        path = Path(prior)
    if not path.exists():
        return prior
    digest = hashlib.sha256()
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
    for file in files:
        line = f"{file.relative_to(path.parent)} {sha256_of(file)}\n"
        digest.update(line.encode(errors="surrogatepass"))
    return digest.hexdigest()[:32]


@functools.cache
def _warm_prior(
    name: str, device_name: str, diffusion: LatentPriorSettings
) -> tuple[Prior, torch.device]:
    """Return this process's prior, and where splats are rendered.

    Raises:
        UserError: it cannot be loaded, or there is no such device.
    """
    from gscomplete.priors import load_prior
    from gscomplete.render.dispatch import choose_render_device
    from gscomplete.util.device import choose_device

    device = choose_device(device_name)
    render_device, _ = choose_render_device(device_name, device)
    knobs = None if diffusion == LatentPriorSettings() else diffusion
    return load_prior(name, device, knobs), render_device
