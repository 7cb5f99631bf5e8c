"""Whether completing P is better than leaving it as it is, by a small network.

If thin wings or an open base show both sides of a complete P's surface, P does not pass for closed
(``framing.extent``), and the shape network adds what is not there, such as a second pair of heads.
Two things tell such a P from one that lacks something: how much of its surface is exposed on both
sides, and how much the network's answers add. The scorer has learned this from parts and complete
objects whose truth is known (``recipes/train_embedded_prior``).

Conventions
-----------
* The chosen answer is the one that ``planes.answer_scorer`` ranks first. Names that end in
  ``_mean`` and ``_least`` are over all answers.
* P's cells and their neighbours count as P's; only what lies elsewhere is new.
"""

from __future__ import annotations

import functools

import numpy as np
import torch
from torch import Tensor

from gscomplete.networks.packaged import PACKAGED_WEIGHTS
from gscomplete.networks.perceptron import Perceptron
from gscomplete.shape.planes.answer_scorer import Answers
from gscomplete.shape.voxels import grown, shadows, surface_cells
from gscomplete.util.arrays import Float32Array

BENEFIT_SCORER_FILE = "benefit.safetensors"
OF_ENDING = (
    "log_exposed",  # share of P's surface that shows both sides, looked at with few points
    "log_exposed_finely",  # with many
    "thickness",
    "is_cut",
    "squareness",  # of the cut; 0 without one, and so the next
    "meets_surface",
    "cut_offset",  # object sizes
)
OF_ANSWERS = (
    "surface",  # share of the chosen answer's surface that is new
    "surface_mean",
    "surface_least",
    "volume",  # share of its filled cells that are new
    "volume_mean",
    "volume_least",
    "shadow",  # share of its shadows that are not P's, their mean
    "shadow_most",  # largest of them
    "shadow_mean",
    "shadow_least",
    "surface_possible",  # as the first, of cells that are less sure
    "shadow_possible",
)
FEATURES = (*OF_ENDING, *OF_ANSWERS)
_FILLED, _POSSIBLE = 0.5, 0.35
"""Cells with larger probabilities count as filled, and as possibly filled."""
LEFT_BELOW = -2.0
"""P is left as it is if its score, the log odds that completing helps, is lower. The limit is not 0
because a quarter of the scorer's training examples are complete, but perhaps a twentieth of what
users bring. Half a captured biker scores -.9."""
_GRID = (1, 2, 3)


@functools.cache
def packaged_benefit_scorer() -> Perceptron:
    """Return the network that ships with the package."""
    return Perceptron.load(PACKAGED_WEIGHTS / BENEFIT_SCORER_FILE, len(FEATURES))


def is_better_left(
    of_ending: Float32Array | None,  # [len(OF_ENDING)]
    of_answers: Float32Array | None,  # [len(OF_ANSWERS)]
) -> bool:
    """Say whether what the network would add makes P worse; False if either argument is None."""
    if of_ending is None or of_answers is None:
        return False
    features = np.concatenate([of_ending, of_answers])
    return float(packaged_benefit_scorer()(features[None])[0]) < LEFT_BELOW


def features_of_answers(answers: Answers, chosen: int) -> Float32Array:  # [len(OF_ANSWERS)]
    """Return the features of the network's answers; columns as ``OF_ANSWERS``."""
    own = answers.partial > 0
    elsewhere = grown(answers.partial[None]) <= 0
    filled, possible = answers.filled > _FILLED, answers.filled > _POSSIBLE
    surface, volume = _share_new(surface_cells(filled), elsewhere), _share_new(filled, elsewhere)
    shadow = _shadows_new(filled, own)
    new_shadow = shadow.mean(dim=0)
    some = possible[chosen : chosen + 1]
    return torch.stack(
        [
            *_chosen_mean_least(surface, chosen),
            *_chosen_mean_least(volume, chosen),
            new_shadow[chosen],
            shadow[:, chosen].amax(),
            shadow.mean(),
            new_shadow.amin(),
            _share_new(surface_cells(some), elsewhere)[0],
            _shadows_new(some, own).mean(),
        ]
    ).numpy()


def _chosen_mean_least(shares: Tensor, chosen: int) -> tuple[Tensor, Tensor, Tensor]:
    return shares[chosen], shares.mean(), shares.amin()


def _share_new(cells: Tensor, elsewhere: Tensor) -> Tensor:  # bool [K, C, C, C], [1, ...] -> [K]
    return (cells & elsewhere).sum(dim=_GRID) / cells.sum(dim=_GRID).clamp_min(1)


def _shadows_new(filled: Tensor, own: Tensor) -> Tensor:  # bool [K, C, C, C], [C, ...] -> [5, K]
    """Return, for five directions, the share of every answer's shadow that P does not cast."""
    shares = []
    for all_of, of_partial in zip(shadows(filled | own), shadows(own[None]), strict=True):
        new = (all_of & ~of_partial).flatten(1).sum(dim=1)
        shares.append(new / all_of.flatten(1).sum(dim=1).clamp_min(1))
    return torch.stack(shares)
