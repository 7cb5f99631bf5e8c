"""Which of the shape network's answers is the best, by a small network.

The shape network is asked once per likely plane, given P's copy (mirror image) through it, and once
without any copy. If a copy is in the wrong place, such as a second head, the answer to it is
unsure, leaves the copy's cells empty, or differs from the other answers; how much each of these
signs tells depends on how P was cut and on how much is missing. The scorer has learned this from
parts of meshes whose truth is known (``recipes/train_embedded_prior``).

Conventions
-----------
* P's cells and their neighbours count as P's; only what lies elsewhere is new.
* An answer with less new surface than the mean over the answers is scored as if it had the mean:
  a copy covers next to no new surface easily.
* The mean answer is the mean of the answers to copies.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gscomplete.networks.packaged import PACKAGED_WEIGHTS
from gscomplete.networks.perceptron import Perceptron
from gscomplete.shape.symmetry import SymmetryMap, plane_of
from gscomplete.shape.voxels import (
    CELLS,
    HALF_SIDE,
    cell_centers,
    grown,
    missing_surface_share,
    surface_cells,
)
from gscomplete.util.arrays import Float32Array
from gscomplete.util.same_bits import fixed_sum

ANSWER_SCORER_FILE = "answers.safetensors"
OF_ANSWER = (
    "sureness",
    "symmetry_score",
    "log_belief",  # in its plane
    "log_cells",  # filled by it, over those of P
    "agreement",  # with the mean answer: intersection over union
    "deviation",  # from the mean answer, over its sum
    "no_copy",
    "on_partial",  # share of the copy that is P's
    "outside_grid",  # share of P whose copy is
    "smaller_side",  # share of P on that side of the plane
    "growth",  # of P's width across the plane by the copy, widths
    "copy_filled",  # mean probability of the copy's new cells
)
OF_PART = (
    "missing",  # share of the surface that is not P's
    "shown_at_once",  # share of P that its best view shows
    "ends_in_plane",
    "log_partial",  # cells of P
)
FEATURES = (
    *OF_ANSWER,
    *(f"{name}_above_mean" for name in OF_ANSWER),
    *(f"{name}_above_most" for name in OF_ANSWER),  # most of the answers to copies
    *OF_PART,
)
_POSSIBLE = 0.1
"""Cells with at least this probability count towards how sure an answer is."""
_FILLED = 0.35
"""Cells with at least this probability count as filled."""
_LEAST_BELIEF = 1e-4
_LEAST_WIDTH = 0.02
WRONG_WEIGHT = 0.5
"""Weight of the share of a copy that is new and wrong, against the share of what is missing that
the copy shows."""
_GRID = (1, 2, 3)


@functools.cache
def packaged_answer_scorer() -> Perceptron:
    """Return the network that ships with the package."""
    return Perceptron.load(PACKAGED_WEIGHTS / ANSWER_SCORER_FILE, len(FEATURES))


@dataclass(frozen=True, slots=True)
class Answers:
    """The questions to the network about one part, and its answers."""

    planes: tuple[SymmetryMap, ...]  # K
    """What P was mirrored through."""
    copies: Tensor  # [K, C, C, C] occupancies of P's mirror images
    filled: Tensor  # [K, C, C, C] or [K + 1, C, C, C]
    """Probabilities of the answers to the K copies, then of the answer to none if it was asked."""
    partial: Tensor  # [C, C, C] occupancy of P
    shown_at_once: float
    """Share of P that its best view shows."""
    ends_in_plane: bool
    """Whether P was cut along a plane, as far as found."""

    def to_copies(self) -> Tensor:  # [K, C, C, C]
        """Return the answers to copies."""
        return self.filled[: len(self.planes)]


def answer_features(answers: Answers) -> Float32Array:  # [K, F] or [K + 1, F]
    """Return what the scorer reads of each answer; columns as ``FEATURES``."""
    filled, count = answers.filled, len(answers.planes)
    of_partial = float((answers.partial > 0).sum()) + 1.0
    mean = answers.to_copies().mean(dim=0)
    of_mean = fixed_sum(mean)
    both = (filled * mean).sum(dim=_GRID)
    either = filled.sum(dim=_GRID) + of_mean - both
    scores = symmetry_scores_of_answers(answers.to_copies(), answers.copies, answers.partial)
    beliefs = torch.tensor([plane.score for plane in answers.planes])
    no_copy = torch.zeros(len(filled))
    no_copy[count:] = 1.0
    of_answer = torch.stack(
        [
            sureness(filled),
            _with_none(scores, no_copy),
            (_with_none(beliefs, no_copy) + _LEAST_BELIEF).log(),
            ((filled > _FILLED).sum(dim=_GRID) + 1.0).log() - math.log(of_partial),
            both / either.clamp_min(1e-6),
            (filled - mean).abs().sum(dim=_GRID) / (of_mean + 1.0),
            no_copy,
            *(_with_none(column, no_copy) for column in _of_copies(answers).T),
        ],
        dim=1,
    )
    of_part = torch.tensor(
        [
            missing_share(answers.to_copies(), answers.partial),
            answers.shown_at_once,
            float(answers.ends_in_plane),
            math.log(of_partial),
        ]
    )
    columns = [
        of_answer,
        of_answer - of_answer.mean(dim=0),
        of_answer - of_answer[:count].amax(dim=0),
        of_part.expand(len(filled), -1),
    ]
    return torch.cat(columns, dim=1).numpy()


def _with_none(of_copies: Tensor, no_copy: Tensor) -> Tensor:  # [K], [N] -> [N]
    """Append 0 for the answer to no copy, if there is one."""
    return torch.cat([of_copies, torch.zeros(len(no_copy) - len(of_copies))])


def _of_copies(answers: Answers) -> Tensor:  # [K, 5]
    """Return the last of ``OF_ANSWER``: what is known of the copies themselves."""
    own = grown(answers.partial[None])[0] > 0
    cells = answers.copies > 0
    new = cells & ~own
    size = cells.sum(dim=_GRID).clamp_min(1)
    new_size = new.sum(dim=_GRID)
    on_partial = 1 - new_size / size
    filled = (answers.to_copies() * new).sum(dim=_GRID) / new_size.clamp_min(1)
    filled = torch.where(new_size > 0, filled, 1.0)
    places = cell_centers(CELLS)[answers.partial.numpy() > 0]
    of_planes = torch.tensor([_of_plane(plane, places) for plane in answers.planes])
    return torch.cat([on_partial[:, None], of_planes, filled[:, None]], dim=1)


def _of_plane(
    plane: SymmetryMap,
    places: Float32Array,  # [N, 3] P's cells
) -> tuple[float, float, float]:
    """Return ``outside_grid``, ``smaller_side`` and ``growth`` of ``OF_ANSWER``."""
    if not len(places):
        return 0.0, 0.0, 0.0
    angle, offset = plane_of(plane)
    across = places[:, 0] * math.cos(angle) + places[:, 1] * math.sin(angle) - offset
    outside = (np.abs(plane.apply(places)) > HALF_SIDE).any(axis=1).mean()
    side = float((across > 0).mean())
    width = float(across.max() - across.min())
    with_copy = 2 * float(np.abs(across).max())  # whose places have the other sign
    return float(outside), min(side, 1 - side), with_copy / max(width, _LEAST_WIDTH) - 1


def sureness(
    filled: Tensor,  # [K, C, C, C] probabilities of the network's answers
) -> Tensor:  # [K] in [0, 1]
    """Return how far probabilities are from one half, as a mean over cells that may be filled."""
    possible = filled > _POSSIBLE
    far = (2 * filled - 1).abs() * possible
    return far.sum(dim=_GRID) / possible.sum(dim=_GRID).clamp_min(1)


def missing_share(
    filled: Tensor,  # [K, C, C, C] probabilities of the network's answers
    partial: Tensor,  # [C, C, C] occupancy of P
) -> float:  # in [0, 1]
    """Return the share of the mean answer's surface that P lacks."""
    return missing_surface_share(filled.mean(dim=0, keepdim=True) > _FILLED, partial[None])


def symmetry_scores_of_answers(
    filled: Tensor,  # [K, C, C, C] probabilities of the network's answers
    copies: Tensor,  # [K, C, C, C] occupancies of the mirror images it was given first
    partial: Tensor,  # [C, C, C] occupancy of P
) -> Tensor:  # [K]
    """Score copies by the answers to them.

    A copy's score is the share of the answer's new surface that it covers, less ``WRONG_WEIGHT``
    times the share of the copy's cells that are new but left empty by the answer.
    """
    elsewhere = grown(partial[None]) <= 0
    new = (copies > 0) & elsewhere
    surface = surface_cells(filled > _FILLED) & elsewhere
    covered = (filled * (surface & (grown(copies) > 0))).sum(dim=_GRID)
    wanted = (filled * surface).sum(dim=_GRID)
    left_empty = ((1 - filled) * new).sum(dim=_GRID) / (copies > 0).sum(dim=_GRID).clamp_min(1)
    return covered / wanted.clamp_min(float(wanted.mean()) + 1e-3) - WRONG_WEIGHT * left_empty
