"""Which mirror images of P the shape network is given: those consistent with its own answers.

Planes are proposed by P's appearance through them. The network knows more of objects, so it is
asked once per likely plane and once without any. Then:

* A part that ends in a plane lacks what lies beyond: a plane is scored by the share of new surface
  that its copy covers, less half the share of the copy that is new and left empty. Where less than
  half is missing, the network's sureness counts more: there is more that a wrong copy contradicts.
* Of other parts the answer that the network is surest of is taken, with a copy or without: a copy
  in the wrong place, such as a second head, leaves it in doubt. What several views show lacks
  little, so that the answer counts that fills less.
* The insides of fences, racks and crates have rims of their own, among which the plane of a cut is
  not found. A part that no view shows much of, and much of which is missing, counts as cut.

Conventions
-----------
* Cells of P and those beside them are P's; only what lies elsewhere counts as new.
* New surface is counted against the mean over the answers where an answer has less of it: one that
  adds next to nothing covers it easily.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.shape.ask import ask
from gscomplete.shape.mirror_plane import Mirror, MirrorPlane
from gscomplete.shape.network import ShapeCompleter, ShapeOutput
from gscomplete.shape.one_view import ONE_VIEW_SHARE
from gscomplete.shape.partial_voxels import PartialVoxels, ShapeInputs
from gscomplete.shape.planes.proposals import candidate_planes
from gscomplete.shape.symmetry import SymmetryMap, mirror, no_symmetries
from gscomplete.shape.voxels import CELLS, FloatArray, grown, surface_cells
from gscomplete.util.stages import stage

CANDIDATES = 8
_POSSIBLE = 0.1
"""Cells with at least this probability count for how sure an answer is."""
_BELIEF_WEIGHT = 0.15
"""Of the logarithm of the belief in a plane, beside the score by the network's answer."""
_FILLED = 0.35
"""Cells with at least this probability count as filled."""
_LEAST_SHOWN = 0.7
"""Share of P that its best view shows. Of parts of unseen objects without a cut that is found, 17
of 33 halves and 35 of 67 that lack a box show less, no arc of 65 and no scan of 59 ..."""
_MUCH_MISSING = 0.25
"""... and share of the surface that is missing then: complete objects lack less."""
_LITTLE_MISSING, _SURENESS_WEIGHT = 0.43, 6.0
"""Of parts that end in a plane and lack a smaller share of the surface, sureness counts so much
beside the score."""
_FILLED_WEIGHT = 0.4
"""Of other parts, where the best view shows less than a scan's, the logarithm of the number of
cells that an answer fills counts against its sureness by this much."""
WRONG_WEIGHT = 0.5
"""Of the share of a copy that is new and wrong, beside the share of the missing that it shows."""


@dataclass(frozen=True, slots=True)
class Choice:
    """What the network is given."""

    seen: ShapeInputs
    symmetry_score: float
    """Of the first mirror image by the network's answer; 0 where none is given, 1 where users chose
    it."""
    answer: ShapeOutput | None = None
    """The network's, for a batch of one; None = it was not asked."""


@dataclass(frozen=True, slots=True)
class ScoredPlanes:
    """Likely planes, by what the network's answers make of them, the best first."""

    planes: tuple[SymmetryMap, ...]
    symmetry_scores: tuple[float, ...]
    """Of each by the answer to it."""
    none_is_best: bool
    """Whether the network's answer to no mirror image is ranked before those to all others."""
    seen: ShapeInputs
    """What the network is given: the best plane, or no mirror image."""
    answer: ShapeOutput
    """Its answer to that."""

    def distinct(self, points: FloatArray) -> tuple[SymmetryMap, ...]:  # points [N, 3] of P
        """Return the planes that show something else than those before them."""
        found: list[SymmetryMap] = []
        for plane in self.planes:
            if not any(plane.is_like(other, points) for other in found):
                found.append(plane)
        return tuple(found)


def choose_symmetries(
    model: ShapeCompleter,
    voxels: PartialVoxels,
    tokens: Tensor,  # [L]
    *,
    ends_in_plane: bool,
    bfloat16: bool = False,
    mirror_plane: Mirror = "guess",
) -> Choice:
    """Choose what the network is given.

    Args:
        model: in evaluation mode, on the CPU.
        voxels: P.
        tokens: the prompt.
        ends_in_plane: whether P was cut along a plane, as far as found (``framing.cut_plane``).
        bfloat16: precision of the network.
        mirror_plane: which one to show first.
    """
    if mirror_plane == "none":
        return Choice(voxels.with_copies(no_symmetries()), 0.0)
    if isinstance(mirror_plane, MirrorPlane):
        planes = candidate_planes(voxels, CANDIDATES, bfloat16=bfloat16)
        angle = math.radians(mirror_plane.azimuth_deg)
        given = mirror(angle, mirror_plane.offset, planes[0].score)
        return Choice(voxels.with_copies(voxels.input_symmetries([given, *planes], 0)), 1.0)
    asked = score_planes(model, voxels, tokens, ends_in_plane=ends_in_plane, bfloat16=bfloat16)
    score = 0.0 if asked.none_is_best else asked.symmetry_scores[0]
    return Choice(asked.seen, score, asked.answer)


@torch.no_grad()
def score_planes(
    model: ShapeCompleter,
    voxels: PartialVoxels,
    tokens: Tensor,  # [L]
    *,
    ends_in_plane: bool,
    bfloat16: bool = False,
) -> ScoredPlanes:
    """Ask the network about every likely plane; arguments as of :func:`choose_symmetries`."""
    with stage("planes"):
        planes = candidate_planes(voxels, CANDIDATES, bfloat16=bfloat16)
    count = len(planes)
    shown = [_symmetries_with_first(voxels, planes, k) for k in range(count)]
    if not ends_in_plane:
        shown.append(no_symmetries())
    copies = torch.empty(count, *(CELLS,) * 3)
    answers = []
    for k, symmetries in enumerate(shown):  # one by one: what a question needs stays in the caches
        seen = voxels.with_copies(symmetries)
        answers.append(ask(model, seen, tokens, bfloat16=bfloat16))
        if k < count:
            copies[k] = torch.from_numpy(seen.volumes[1, 0])
    filled = torch.cat([answer.occupancy for answer in answers]).sigmoid_()
    partial = torch.from_numpy(voxels.volume[0])
    missing = missing_share(filled[:count], partial)
    shown_at_once = 1.0 if ends_in_plane else voxels.shown_at_once
    if missing > _MUCH_MISSING and shown_at_once < _LEAST_SHOWN:
        ends_in_plane = True
    scores = symmetry_scores_of_answers(filled[:count], copies, partial)
    rank = sureness(filled)
    if ends_in_plane:
        belief = torch.tensor([plane.score for plane in planes])
        sure_weight = _SURENESS_WEIGHT if missing < _LITTLE_MISSING else 0.0
        rank = sure_weight * rank[:count] + scores + _BELIEF_WEIGHT * (belief + 1e-4).log()
    elif shown_at_once < ONE_VIEW_SHARE:
        cells = (filled > _FILLED).sum(dim=(1, 2, 3))
        rank = rank - _FILLED_WEIGHT * (cells + 1.0).log()
    order = rank[:count].argsort(descending=True, stable=True).tolist()
    none_is_best = not ends_in_plane and bool(rank[count] > rank[:count].max())
    best = count if none_is_best else order[0]
    return ScoredPlanes(
        tuple(planes[k] for k in order),
        tuple(float(scores[k]) for k in order),
        none_is_best,
        voxels.with_copies(shown[best]),
        answers[best],
    )


def sureness(
    filled: Tensor,  # [K, C, C, C] probabilities of the network's answers
) -> Tensor:  # [K] in [0, 1]
    """Return how far answers are from one half, on average over the cells that may be filled."""
    possible = filled > _POSSIBLE
    far = (2 * filled - 1).abs() * possible
    return far.sum(dim=(1, 2, 3)) / possible.sum(dim=(1, 2, 3)).clamp_min(1)


def missing_share(
    filled: Tensor,  # [K, C, C, C] probabilities of the network's answers
    partial: Tensor,  # [C, C, C] occupancy of P
) -> float:  # in [0, 1]
    """Return how much of the surface that the answers have on average is not P's."""
    surface = surface_cells(filled.mean(dim=0, keepdim=True) > _FILLED)
    away = surface & (grown(partial[None]) <= 0)
    return float(away.sum()) / max(float(surface.sum()), 1.0)


def symmetry_scores_of_answers(
    filled: Tensor,  # [K, C, C, C] probabilities of the network's answers
    copies: Tensor,  # [K, C, C, C] occupancies of the mirror images it was given first
    partial: Tensor,  # [C, C, C] occupancy of P
) -> Tensor:  # [K]
    """Return the scores of copies by the answers to them; see the module's description."""
    cells = (1, 2, 3)
    elsewhere = grown(partial[None]) <= 0
    new = (copies > 0) & elsewhere
    surface = surface_cells(filled > _FILLED) & elsewhere
    covered = (filled * (surface & (grown(copies) > 0))).sum(dim=cells)
    wanted = (filled * surface).sum(dim=cells)
    left_empty = ((1 - filled) * new).sum(dim=cells) / (copies > 0).sum(dim=cells).clamp_min(1)
    return covered / wanted.clamp_min(float(wanted.mean()) + 1e-3) - WRONG_WEIGHT * left_empty


def _symmetries_with_first(
    voxels: PartialVoxels, planes: list[SymmetryMap], index: int
) -> tuple[SymmetryMap, ...]:  # COPIES
    """Show one plane first, as if it were the likeliest."""
    as_likely = list(planes)
    as_likely[index] = dataclasses.replace(planes[index], score=planes[0].score)
    return voxels.input_symmetries(as_likely, index)
