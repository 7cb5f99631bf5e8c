"""Real objects for batches: those of SplatComplete-open, and parts of a pack of meshes.

Conventions
-----------
* The manifest, ``OUT/objects.jsonl``, names first the objects of a dataset that is built already,
  then parts of the pack's validation split, one of each object, the kinds of parts in turn.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from gscomplete.batch.manifest import plan
from gscomplete.errors import UserError
from gscomplete.splats import write_splats
from gscomplete.util.atomic import atomic_path
from recipes.real_objects.unseen import CUT_KINDS, chosen_entries, complete_object, part_of
from recipes.train_embedded_prior.data.mesh_pack import read_mesh

_KINDS = tuple(kind for kind in CUT_KINDS if kind != "complete")


def make_objects(out: Path, dataset: Path | None, meshes: Path | None, count: int) -> Path:
    """Write objects and their manifest; what is there already is kept.

    Args:
        out: folder.
        dataset: of SplatComplete-open; None = none of its objects.
        meshes: the pack; None = no parts of it.
        count: of objects.

    Returns:
        The manifest.

    Raises:
        UserError: there are not so many objects.
    """
    folder = out / "parts"
    folder.mkdir(parents=True, exist_ok=True)
    items = [] if dataset is None else plan(str(dataset), {})[:count]
    rows = [{"id": item.id, "partial": item.source} for item in items]
    needed = count - len(rows)
    entries = [] if meshes is None or not needed else chosen_entries(meshes, needed)
    if len(entries) < needed:
        raise UserError(f"expected {count} objects, found {len(rows) + len(entries)}")
    for number, entry in enumerate(entries):
        kind = _KINDS[number % len(_KINDS)]
        name = f"{entry.id.replace('/', '_')}_{kind}"
        path = folder / f"{name}.ply"
        if not path.exists():
            assert meshes is not None
            random = np.random.default_rng((number, 0))
            turn_deg = float(random.uniform(0, 360))
            complete = complete_object(read_mesh(meshes, entry), entry, turn_deg)
            write_splats(path, part_of(complete, kind, random, turn_deg))
        rows.append({"id": name, "partial": str(path.absolute()), "prompt": entry.caption})
    manifest = out / "objects.jsonl"
    with atomic_path(manifest) as temporary:
        temporary.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    return manifest
