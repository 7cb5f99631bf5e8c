"""Complete parts of objects that nothing was trained or tuned on: ``--meshes DIR --out DIR``.

``python -m recipes.real_objects.unseen --meshes PACK --out runs/unseen`` takes the validation split
of a pack of meshes (all scanned objects and a part of the others), cuts every object in six ways,
completes the parts as a run would and compares them with the truth. Settings and weights are chosen
here; the benchmark's objects (``compare``) only tell whether something broke.

Conventions
-----------
* Parts: ``scan``, one scanner view; ``arc``, views along 100 degrees; ``half``, an upright plane at
  a random azimuth and offset; ``box``, 40 % of the splats inside a box taken away; ``complete``;
  ``middle``, an upright plane through the middle along one of the mesh's own axes; ``capture``,
  splats trained from photos of one side (``captured``; only if asked for: a minute each).
  All are fixed by the object's place in the list.
* Ways: ``input`` (P alone), ``likeliest`` and ``mirror`` (see ``compare``), and the presets.
* Frames and input views are guessed from the part; that a capture is one is known. Every object is
  turned by a fixed random angle.
* Means are over objects; intervals are 95 % bootstrap intervals over objects.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch
from numpy.typing import ArrayLike
from rich.console import Console
from rich.progress import track
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.evaluate.bootstrap import bootstrap_interval
from gscomplete.evaluate.geometry import hidden_surface_errors
from gscomplete.priors import load_prior
from gscomplete.priors.base import prior_identity
from gscomplete.splats import Splats, colors_to_sh, concatenate, write_splats
from gscomplete.util import jsonio
from recipes.entry_point import start
from recipes.real_objects.captured import captured_part
from recipes.real_objects.compare import (
    FramedObject,
    Outcome,
    Way,
    frame_object,
    measure,
    outcome_of,
)
from recipes.real_objects.flawed import Flaw, with_flaw
from recipes.real_objects.load import RealObject
from recipes.results import Results
from recipes.train_embedded_prior.data.mesh_pack import (
    PackEntry,
    PackMesh,
    read_manifest,
    read_mesh,
)
from recipes.train_embedded_prior.procedural.quads import turn_about
from splatcomplete_data.cuts.geometry import (
    by_box,
    by_plane,
    by_visibility,
    eyes_at,
    splat_points,
)
from splatcomplete_data.cuts.named import SCAN_DISTANCE
from splatcomplete_data.mesh.discs import ColoredTriangles, sample_triangles, triangles_to_discs

PartKind = Literal["scan", "arc", "half", "box", "complete", "middle", "capture"]
CUT_KINDS: tuple[PartKind, ...] = ("scan", "arc", "half", "box", "complete", "middle")
"""Kinds that are cut out of the complete object's splats."""
_SCANNED = ("gso", "gso-shape")
_OTHERS = 60
"""Objects of other sources than scans, evenly spread over their list."""
_SPLATS = 20_000
_SCAN_FOV_DEG = 35.0
_ARC_DEG = 100.0
_BOX_SHARE = 0.4
_LARGEST_OFFSET = 0.12
_FEWEST_SHARE = 0.1
"""A half that keeps less of a thin object is cut through the middle instead."""
_FLAT_COLOR = (0.6, 0.6, 0.6)


@dataclass(frozen=True)
class Options:
    """Complete parts of unseen objects and measure the results."""

    meshes: Path
    """Folder of the pack of meshes."""
    out: Path
    """Folder for ``results.json``; an interrupted run goes on from it."""
    ways: tuple[Way, ...] = ("input", "fast")
    """Ways to complete, from ``compare``."""
    kinds: tuple[PartKind, ...] = CUT_KINDS
    """Kinds of parts."""
    flaw: Flaw = "none"
    """What is added to every part, as captures have it."""
    objects: int | None = None
    """Number of objects, evenly spread over the list; None = all."""
    weights: Path | None = None
    """Folder of weights; None = the package's."""
    keep: bool = False
    """Keep parts and completions as splat files."""
    seed: int = 0


def chosen_entries(folder: Path, count: int | None) -> list[PackEntry]:
    """Return the objects to complete: scans, then others.

    Raises:
        UserError: the folder has no manifest.
    """
    rows = [entry for entry in read_manifest(folder) if entry.split == "validation"]
    scanned = [entry for entry in rows if entry.source in _SCANNED]
    found = scanned + _evenly([e for e in rows if e.source not in _SCANNED], _OTHERS)
    return found if count is None else _evenly(found, count)


def _evenly(entries: list[PackEntry], count: int) -> list[PackEntry]:
    if count >= len(entries):
        return entries
    return [entries[math.floor((k + 0.5) * len(entries) / count)] for k in range(count)]


def complete_object(mesh: PackMesh, entry: PackEntry, turn_deg: float) -> Splats:
    """Cover a mesh with splats, turned about the up axis."""
    triangles = mesh.vertices[mesh.faces]
    turn = turn_about("z", turn_deg)
    corners = (triangles.reshape(-1, 3) @ turn.T).reshape(-1, 3, 3).astype(np.float32)
    plain = np.full_like(corners, 0.0) + np.array(_FLAT_COLOR, np.float32)
    splats = triangles_to_discs(ColoredTriangles(corners, plain), _SPLATS)
    if entry.colour == "none":
        return splats
    return _painted(splats, mesh, turn)


def _painted(splats: Splats, mesh: PackMesh, turn: np.ndarray) -> Splats:
    """Give splats the mesh's colours at its nearest surface samples."""
    triangles = mesh.vertices[mesh.faces]
    face, weights = sample_triangles(triangles, 4 * _SPLATS, 1)
    points = np.einsum("nk,nkc->nc", weights, triangles[face]) @ turn.T
    _, nearest = cKDTree(points).query(splat_points(splats))
    colors = mesh.colors_at(face, weights)[nearest].astype(np.float32)
    return dataclasses.replace(splats, sh=colors_to_sh(torch.from_numpy(colors)))


def part_of(
    splats: Splats, kind: PartKind, rng: np.random.Generator, turn_deg: float = 0.0
) -> Splats:
    """Cut a complete object that is turned by ``turn_deg``."""
    azimuth = float(rng.uniform(0, 2 * math.pi))
    offset = float(rng.uniform(-_LARGEST_OFFSET, _LARGEST_OFFSET))
    if kind == "complete":
        return splats
    if kind == "capture":
        return captured_part(splats, rng)
    if kind == "middle":
        turned = math.radians(turn_deg + 90.0 * int(rng.integers(2)))
        normal = (math.cos(turned), math.sin(turned), 0.0)
        low, high = splats.bounds()
        center = ((low + high) / 2).double().numpy()
        return splats.select(by_plane(splats, normal, float(center @ normal)).mask)
    if kind == "half":
        normal = (math.cos(azimuth), math.sin(azimuth), 0.0)
        mask = by_plane(splats, normal, offset).mask
        if float(mask.float().mean()) < _FEWEST_SHARE:
            mask = by_plane(splats, normal, 0.0).mask
        return splats.select(mask)
    if kind == "box":
        points = splat_points(splats)
        anchor = points[int(rng.integers(len(points)))]
        reach = np.abs(points - anchor).max(axis=1)
        side = 2.0 * float(np.quantile(reach, _BOX_SHARE))
        return splats.select(by_box(splats, anchor, (side,) * 3, keep="outside").mask)
    turns_deg = (0.0,) if kind == "scan" else (-_ARC_DEG / 2, 0.0, _ARC_DEG / 2)
    elevation = math.radians(float(rng.uniform(5, 30)))
    return splats.select(seen_from(splats, azimuth + np.deg2rad(turns_deg), elevation))


def seen_from(splats: Splats, azimuth_rad: ArrayLike, elevation_rad: float) -> Tensor:  # [N] bool
    """Mark what a scanner sees of a complete object from one azimuth or several.

    Args:
        splats: in a frame like the object frame: centred, largest side about 1.
        azimuth_rad: [V] or a number.
        elevation_rad: of all viewpoints.
    """
    eyes = eyes_at(azimuth_rad, elevation_rad, SCAN_DISTANCE)
    return by_visibility(splats, eyes, fov_deg=_SCAN_FOV_DEG).mask


def measure_all(framed: FramedObject, outcome: Outcome) -> dict[str, Any]:
    """Return the numbers of ``compare`` and those of the hidden surface."""
    assert framed.truth is not None
    partial = framed.partial.with_sh_degree(0)
    completed = concatenate([partial, outcome.splats])
    surface = hidden_surface_errors(completed, partial, framed.truth)
    row = measure(framed, outcome)
    return row if surface is None else row | jsonio.to_json(surface)


def main(options: Options) -> None:
    """Complete and measure."""
    prior = load_prior("embedded" if options.weights is None else str(options.weights))
    made_with = {"seed": options.seed, "prior": prior_identity(prior)}
    if options.flaw != "none":
        made_with["flaw"] = options.flaw
    results = Results(options.out / "results.json", made_with)
    entries = chosen_entries(options.meshes, options.objects)
    for entry in track(entries, "objects", console=Console(file=sys.stderr)):
        number = entry.number
        turn_deg = float(np.random.default_rng((number, 0)).uniform(0, 360))
        complete: Splats | None = None
        for kind in options.kinds:
            rows = results.rows.setdefault(f"{entry.id}:{kind}", {"prompt": entry.caption})
            if all(way in rows for way in options.ways):
                continue
            if complete is None:
                mesh = read_mesh(options.meshes, entry)
                complete = complete_object(mesh, entry, turn_deg)
            cut_rng = np.random.default_rng((number, 1 + get_args(PartKind).index(kind)))
            partial = part_of(complete, kind, cut_rng, turn_deg)
            partial = with_flaw(partial, complete, options.flaw, cut_rng)
            about = entry.id, entry.caption, "Z", partial, complete, kind
            item = RealObject(*about, captured=kind == "capture")
            framed = frame_object(item, prior)
            for way in options.ways:
                if way not in rows:
                    outcome = outcome_of(framed, way, prior, options.seed)
                    rows[way] = measure_all(framed, outcome)
                    if options.keep:
                        name = f"{entry.id.replace('/', '_')}.{kind}"
                        _keep(options.out, name, way, framed, outcome)
            results.save()
    sys.stdout.write(table(results.rows, options.ways, options.kinds))


def _keep(out: Path, name: str, way: str, framed: FramedObject, outcome: Outcome) -> None:
    """Write a completion, its part and the truth."""
    assert framed.truth is not None
    partial = framed.partial.with_sh_degree(0)
    write_splats(out / f"{name}.{way}.ply", concatenate([partial, outcome.splats]))
    write_splats(out / f"{name}.input.ply", partial)
    write_splats(out / f"{name}.truth.ply", framed.truth)


_COLUMNS = (
    ("silhouette_iou", "IoU", ".3f"),
    ("silhouette_missed", "missed", ".3f"),
    ("silhouette_excess", "excess", ".3f"),
    ("hidden_color_psnr_db", "PSNR", ".2f"),
    ("haarpsi", "HaarPSI", ".3f"),
    ("f_score_1", "F 1 %", ".3f"),
    ("f_score_3", "F 3 %", ".3f"),
    ("e_color_v", "E_color", ".5f"),
    ("seconds", "s", ".1f"),
)


def table(
    rows: dict[str, dict[str, Any]], ways: tuple[Way, ...], kinds: tuple[PartKind, ...]
) -> str:
    """Show means by kind of part and way, with an interval for the silhouettes."""
    head = f"{'part':9}{'way':11}{'n':>4}" + "".join(f"{label:>9}" for _, label, _ in _COLUMNS)
    lines = [head + "   IoU 95 %       worse than P"]
    for kind in kinds:
        chosen = [row for name, row in rows.items() if name.endswith(f":{kind}")]
        for way in ways:
            found = [row[way] for row in chosen if way in row]
            if not found:
                continue
            cells = []
            for key, _, form in _COLUMNS:
                known = [row[key] for row in found if row.get(key) is not None]
                cells.append(f"{np.mean(known):9{form}}" if known else f"{'-':>9}")
            values = np.array([row["silhouette_iou"] for row in found])
            low, high = bootstrap_interval(values.tolist())
            worse = ""
            if all("input" in row for row in chosen):
                alone = np.array([row["input"]["silhouette_iou"] for row in chosen if way in row])
                worse = f"{100 * float((values < alone - 0.005).mean()):5.1f} %"
            lines.append(
                f"{kind:9}{way:11}{len(found):4}"
                + "".join(cells)
                + f"   {low:.3f}-{high:.3f} {worse}"
            )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    start(main, Options, __doc__)
