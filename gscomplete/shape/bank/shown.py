"""What the network answers when it is shown known shapes in the place of a mirror image.

Each answer to a known shape is often wrong. They count beside the plain answer, that to none, where
they agree about as much among themselves as with it, and not too little with it.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from gscomplete.shape.ask import ORIENTATIONS, mean_answer
from gscomplete.shape.bank.fit import FittedShape
from gscomplete.shape.network import ShapeCompleter
from gscomplete.shape.partial_voxels import PartialVoxels, ShapeInputs

LEAST_SHOWN = 2
"""Fewer known shapes do not agree among themselves."""
_LEAST_PLAIN_AGREEMENT = 0.4
"""Of the plain answer with those to known shapes (IoU of filled cells). Below it they are of
another object ..."""
_MOST_PLAIN_AGREEMENT = 0.75
"""... and above it the plain answer is taken: it is like them, and mirrors P itself."""
_LEAST_LEAD = -0.05
"""How much more the answers to known shapes must agree among themselves than with the plain one."""
_LIKELY = -0.5
"""Cells are compared where they are filled from this logit on."""


def occupancy_by_shapes(
    model: ShapeCompleter,
    voxels: PartialVoxels,
    seen: ShapeInputs,
    plain: Tensor,  # [1, C, C, C] logits, the answer to ``seen``
    shapes: Sequence[FittedShape],
    tokens: Tensor,  # [L]
    *,
    bfloat16: bool,
) -> Tensor | None:  # [1, C, C, C] logits
    """Return what is filled by the answers that count; None where the plain one stays as it is.

    Args:
        model: in evaluation mode, on the CPU.
        voxels: P.
        seen: what the plain answer was given.
        plain: the plain answer.
        shapes: known shapes in place, the best first.
        tokens: the prompt.
        bfloat16: precision of the network.
    """
    if len(shapes) < LEAST_SHOWN:
        return None
    shown = []
    for shape in shapes:
        given = voxels.with_shape(seen, shape.points)
        answer = mean_answer(model, given, (tokens,) * ORIENTATIONS, bfloat16=bfloat16)
        shown.append(answer.occupancy)
    counting = answers_that_count(shown, plain)
    return torch.stack(counting).mean(dim=0) if counting else None


def answers_that_count(
    shown: Sequence[Tensor],  # logits, answers to known shapes, the best first
    plain: Tensor,  # logits, the answer to none
) -> list[Tensor]:
    """Return the answers that the guess is the mean of; none = the plain one as it is.

    Args:
        shown: answers to known shapes.
        plain: answer to none.
    """
    among, with_plain = _mean_overlap(shown[0], shown[1:]), _mean_overlap(plain, shown)
    is_like_them = with_plain > _MOST_PLAIN_AGREEMENT
    if with_plain < _LEAST_PLAIN_AGREEMENT or is_like_them or among < with_plain + _LEAST_LEAD:
        return []
    return [plain, *shown]


def _mean_overlap(one: Tensor, others: Sequence[Tensor]) -> float:
    """Return the mean overlap (IoU) of the cells that answers fill, as counted here."""
    return sum(_overlap(one > _LIKELY, other > _LIKELY) for other in others) / len(others)


def _overlap(one: Tensor, other: Tensor) -> float:
    return float((one & other).sum()) / max(float((one | other).sum()), 1.0)
