"""Which mirror images of P the shape network is shown: those that its own answers bear out.

The ranker judges planes by what P looks like through them. The network knows more of objects: shown
a copy, it fills the copy's cells or leaves them empty. So it is asked once per likely plane, and by
each answer the plane is worth the share of the answer's new surface that the copy covers, less half
the share of the copy that is new and left empty. On real objects that no benchmark uses, the planes
chosen so were worth .49 by the truth; those that the ranker puts first .35, the best plane .72.

Conventions
-----------
* Cells of P and those beside them are P's; only what lies elsewhere counts as new.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from gscomplete.priors.embedded.shape.inputs import PartLook, ShapeInputs
from gscomplete.priors.embedded.shape.model import ShapeCompleter
from gscomplete.priors.embedded.shape.symmetries import SymmetryMap, shown_symmetries

CANDIDATES = 8
_BELIEF_WEIGHT = 0.1
"""Of the logarithm of the ranker's belief, beside the worth by the network's answer."""
_FILLED = 0.35
"""Cells with at least this probability count as filled."""
_WRONG_WEIGHT = 0.5


@torch.no_grad()
def choose_symmetries(
    model: ShapeCompleter,
    look: PartLook,
    tokens: Tensor,  # [L]
    *,
    bfloat16: bool = False,
) -> tuple[SymmetryMap, ...]:
    """Return what the network is to be shown.

    Args:
        model: in evaluation mode, on the CPU.
        look: P.
        tokens: the prompt.
        bfloat16: precision of the network.
    """
    planes = look.candidates(CANDIDATES)
    asked = [_inputs_with_first(look, planes, k) for k in range(len(planes))]
    volumes = torch.from_numpy(np.stack([a.volumes for a in asked]))
    precision: contextlib.AbstractContextManager[None] = torch.autocast(
        "cpu", torch.bfloat16, enabled=bfloat16
    )
    with precision:
        answer = model(
            volumes,
            torch.from_numpy(look.shares).expand(len(asked), -1, -1, -1, -1),
            torch.from_numpy(np.stack([a.scores for a in asked])),
            tokens.expand(len(asked), -1),
        )
    filled = answer.occupancy.float().sigmoid()
    worth = [
        answered_worth(p, copy, volumes[0, 0, 0]) + _BELIEF_WEIGHT * math.log(plane.score + 1e-4)
        for p, copy, plane in zip(filled, volumes[:, 1, 0], planes, strict=True)
    ]
    best = np.argsort(worth, kind="stable")[::-1]
    return shown_symmetries(planes[best[0]], planes[best[1]])


def answered_worth(
    filled: Tensor,  # [C, C, C] probabilities of the network's answer
    copy: Tensor,  # [C, C, C] occupancy of the mirror image it was shown first
    partial: Tensor,  # [C, C, C] occupancy of P
) -> float:
    """Return what a copy is worth by the answer to it; see the module's description."""
    elsewhere = _grown(partial) <= 0
    new = (copy > 0) & elsewhere
    solid = (filled > _FILLED).float()
    surface = (solid > 0) & (_grown(1 - solid) > 0) & elsewhere
    covered = surface & (_grown(copy) > 0)
    share_covered = (filled * covered).sum() / (filled * surface).sum().clamp_min(1e-3)
    left_empty = ((1 - filled) * new).sum() / (copy > 0).sum().clamp_min(1)
    return float(share_covered - _WRONG_WEIGHT * left_empty)


def _grown(volume: Tensor) -> Tensor:  # [C, C, C] -> [C, C, C]
    return F.max_pool3d(volume[None], 3, 1, 1)[0]


def _inputs_with_first(look: PartLook, planes: list[SymmetryMap], index: int) -> ShapeInputs:
    """Show one plane first, as if it were the likeliest, and the likeliest other one beside it."""
    other = planes[1] if index == 0 else planes[0]
    first = dataclasses.replace(planes[index], score=planes[0].score)
    second = dataclasses.replace(other, score=planes[1].score)
    return look.with_copies(shown_symmetries(first, second))
