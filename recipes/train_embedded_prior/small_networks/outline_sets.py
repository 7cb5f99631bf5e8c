"""Training data of the outline scorer: parts seen from all sides, and how whole their outlines are.

Conventions
-----------
* Every object gives a scan, an arc of 100 degrees, an arc of any width and a cut part. About every
  third object is also used as a whole, and the first ``_MORE_CUT_SHARE`` of the objects give two
  more cut parts, one of which lacks a box. All this depends only on the seed and the object's id.
* About a third of the parts (``_NOISY_SHARE``) is noisy and has holes.
* Captures lack their strays as far as a run finds them.
* An outline's share is the share of the complete object's outline that P's outline covers.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import torch

from gscomplete.framing.cut_plane import find_cut
from gscomplete.priors.embedded.ending import ends_in_plane
from gscomplete.shape.outline.scorer import FEATURES, outline_features
from gscomplete.shape.outline.views import SIDE_PX, outline, views_at
from gscomplete.splats import Splats
from gscomplete.splats.geometry.neighbourhood import flat_axes
from gscomplete.splats.strays import packaged_stray_scorer
from gscomplete.splats.working_set import working_set
from gscomplete.util.arrays import Float32Array
from gscomplete.views import ViewDistribution
from gscomplete.views.frame import up_rotation
from recipes.real_objects.unseen import PartKind, seen_from
from recipes.train_embedded_prior.small_networks.array_sets import joined, made_of_tasks, stem_of
from recipes.train_embedded_prior.small_networks.object_tasks import (
    CapturesConfig,
    CaptureTask,
    ObjectTask,
    TurnedObject,
    sets_of_objects,
)

FILE_OBJECTS, FILE_CAPTURES = 48, 5
CAPTURE = "capture"
KINDS = ("scan", "arc", "wide", "half", "middle", "box", "complete", CAPTURE)
VIEWS = len(views_at(1.0))
_CUT: tuple[PartKind, ...] = ("half", "half", "middle", "box")
"""A kind is drawn as often as it stands here."""
_MORE_CUT_SHARE = 0.75
"""Share of the objects that give more cut parts."""
_COMPLETE_SHARE = 1 / 3
"""Share of the objects that are also used as a whole."""
_SPANS_DEG, _MOST_SCANNERS, _MOST_ELEVATION_DEG = (40.0, 200.0), 5, 40.0
"""For arcs of any width: their range of widths, the most scanners, the largest elevation."""
_NOISY_SHARE, _MOST_NOISE, _MOST_HOLES = 0.35, 0.006, 4
_HOLE_RADII = (0.02, 0.1)
_FEWEST_LEFT = 0.5
"""If holes leave a smaller share of a part, it gets none."""
_FEWEST_SPLATS = 500


@dataclass(frozen=True, slots=True)
class OutlineSets:
    """N parts, each from V views."""

    features: Float32Array  # [N, V, F]
    shares: Float32Array  # [N, V] of the complete object's outline
    kinds: Float32Array  # [N] index into ``KINDS``

    def __len__(self) -> int:
        return len(self.shares)


def outline_sets_of(task: ObjectTask) -> OutlineSets:
    """Return the sets of the parts of one object."""
    return _sets_of(task, (), _parts)


def cut_sets_of(task: ObjectTask) -> OutlineSets:
    """Return the sets of two more cut parts of one object."""
    return _sets_of(task, (1,), _more_cut_parts)


def capture_sets_of(task: CaptureTask) -> OutlineSets:
    """Return the set of a capture of one object."""
    turned, capture = task.captured()
    return _sets_of_parts(turned, [(CAPTURE, capture)])


def _sets_of(
    task: ObjectTask,
    seeds: tuple[int, ...],
    parts: Callable[[TurnedObject], Iterator[tuple[str, Splats]]],
) -> OutlineSets:
    turned = task.turned(task.seed, *seeds)
    return _sets_of_parts(turned, parts(turned))


def _sets_of_parts(turned: TurnedObject, parts: Iterable[tuple[str, Splats]]) -> OutlineSets:
    shape = (0, VIEWS)
    rows = [OutlineSets(*(np.empty(s, np.float32) for s in ((*shape, len(FEATURES)), shape, (0,))))]
    for kind, part in parts:
        framed = turned.framed(part, kind)
        if framed is None:
            continue
        assert framed.truth is not None
        part, views = framed.partial, framed.views
        if kind == CAPTURE:
            part = working_set(part, None, turned.entry.id, up_rotation("Z")).heeded
        points = part.means.double().numpy()
        in_plane = ends_in_plane(find_cut(points, flat_axes(part)))
        features = outline_features(points, views, ends_in_plane=in_plane)
        shares = outline_shares(points, framed.truth.means.numpy(), views)
        number = np.array([KINDS.index(kind)], np.float32)
        rows.append(OutlineSets(features[None], shares[None], number))
    return joined(rows)


def _parts(turned: TurnedObject) -> Iterator[tuple[str, Splats]]:
    rng = turned.rng
    cut = _CUT[int(rng.integers(len(_CUT)))]
    kinds: list[PartKind] = ["scan", "arc", cut]
    if rng.random() < _COMPLETE_SHARE:
        kinds.append("complete")
    for kind in kinds:
        yield kind, _worn(turned.part(kind), rng)
    yield "wide", _worn(_wide_arc(turned.complete, rng), rng)


def _more_cut_parts(turned: TurnedObject) -> Iterator[tuple[str, Splats]]:
    rng = turned.rng
    kinds: tuple[PartKind, ...] = ("box", _CUT[int(rng.integers(len(_CUT)))])
    for kind in kinds:
        yield kind, _worn(turned.part(kind), rng)


def _wide_arc(complete: Splats, rng: np.random.Generator) -> Splats:
    """Return what a few scanners see that stand on an arc of random width."""
    half = math.radians(float(rng.uniform(*_SPANS_DEG))) / 2
    count = int(rng.integers(2, _MOST_SCANNERS + 1))
    azimuths = float(rng.uniform(0, 2 * math.pi)) + np.linspace(-half, half, count)
    elevation = math.radians(float(rng.uniform(0, _MOST_ELEVATION_DEG)))
    return complete.select(seen_from(complete, azimuths, elevation))


def _worn(part: Splats, rng: np.random.Generator) -> Splats:
    """Add noise and holes to the part, if it is one of those that get them."""
    if rng.random() >= _NOISY_SHARE or len(part) < _FEWEST_SPLATS:
        return part
    noise = rng.normal(0.0, float(rng.uniform(0, _MOST_NOISE)), (len(part), 3))
    points = part.means.numpy() + noise.astype(np.float32)
    kept = np.ones(len(part), np.bool_)
    for _ in range(int(rng.integers(_MOST_HOLES + 1))):
        anchor = points[int(rng.integers(len(points)))]
        kept &= np.linalg.norm(points - anchor, axis=1) > rng.uniform(*_HOLE_RADII)
    if kept.mean() < _FEWEST_LEFT:
        kept[:] = True
    moved = dataclasses.replace(part, means=torch.from_numpy(points))
    return moved.select(torch.from_numpy(kept))


def outline_shares(
    points: Float32Array,  # [N, 3] P's points, object frame
    truth: Float32Array,  # [M, 3] points of the complete object
    views: ViewDistribution,
) -> Float32Array:  # [V]
    """Return the share of the complete object's outline that P's covers, from each view."""
    target = np.array(views.target, np.float32)
    shares = []
    for view in views_at(views.radius):
        true = np.zeros(SIDE_PX**2, np.bool_)
        true[view.pixels(truth - target)[0]] = True
        covered = outline(view.pixels((points - target).astype(np.float32))[0]).ravel()
        shares.append((covered & true).sum() / true.sum())
    return np.array(shares, np.float32)


def outline_sets(config: CapturesConfig) -> list[OutlineSets]:
    """Return the sets of every file; make the files that are missing."""
    contents = " ".join(FEATURES)
    ways = (("outlines", outline_sets_of, 1.0), ("cuts", cut_sets_of, _MORE_CUT_SHARE))
    made = [
        sets_of_objects(config, OutlineSets, kind, contents, make, FILE_OBJECTS, share)
        for kind, make, share in ways
    ]
    captures = config.capture_tasks()
    if captures:
        left_out = packaged_stray_scorer().digest()
        stem = stem_of(config.run, "captures", f"{left_out} {contents}")
        how = capture_sets_of, captures, FILE_CAPTURES, config.workers
        made.append(made_of_tasks(OutlineSets, stem, *how))
    files = max(map(len, made))
    return [joined([sets[k] for sets in made if k < len(sets)]) for k in range(files)]
