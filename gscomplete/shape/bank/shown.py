"""What the network answers when it is shown known shapes in the place of a mirror image.

The "plain" answer is the one without a known shape. A single answer to a known shape is often
wrong. Such answers are averaged with the plain one only if they agree among themselves about as
much as with the plain answer, and if they agree with that neither too little nor so much that they
add nothing.
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
"""Agreement among known shapes takes at least two of them."""
_LEAST_PLAIN_AGREEMENT = 0.4
"""Least agreement of the plain answer with those to known shapes (mean IoU of filled cells). Below
it, the known shapes are probably of another object."""
_MOST_PLAIN_AGREEMENT = 0.75
"""Above this agreement the plain answer is taken as it is: it hardly differs from the others, and
it has P's own mirror image."""
_LEAST_LEAD = -0.05
"""Agreement of the answers to known shapes among themselves less that with the plain answer, at
least."""
_LIKELY = -0.5
"""A cell counts as filled in these comparisons from this logit on."""


def occupancy_by_shapes(
    model: ShapeCompleter,
    voxels: PartialVoxels,
    inputs: ShapeInputs,
    plain: Tensor,  # [1, C, C, C] logits, the answer to ``inputs``
    shapes: Sequence[FittedShape],
    tokens: Tensor,  # [L]
    *,
    bfloat16: bool,
) -> Tensor | None:  # [1, C, C, C] logits
    """Return the mean logits of the answers that count; None = the plain answer stays as it is.

    Args:
        model: in evaluation mode, on the CPU.
        voxels: P.
        inputs: the inputs that the plain answer was given to.
        plain: the plain answer.
        shapes: known shapes fitted to P, the best first.
        tokens: the prompt.
        bfloat16: whether the network runs in bfloat16.
    """
    if len(shapes) < LEAST_SHOWN:
        return None
    shown = []
    for shape in shapes:
        given = voxels.with_shape(inputs, shape.points)
        answer = mean_answer(model, given, (tokens,) * ORIENTATIONS, bfloat16=bfloat16)
        shown.append(answer.occupancy)
    counting = answers_that_count(shown, plain)
    return torch.stack(counting).mean(dim=0) if counting else None


def answers_that_count(
    shown: Sequence[Tensor],  # logits, answers to known shapes, the best first
    plain: Tensor,  # logits, the answer to none
) -> list[Tensor]:
    """Return the answers to average, the plain one first; none of them = it stays as it is.

    Args:
        shown: answers to known shapes, at least two.
        plain: the plain answer.
    """
    among, with_plain = _mean_overlap(shown[0], shown[1:]), _mean_overlap(plain, shown)
    is_like_them = with_plain > _MOST_PLAIN_AGREEMENT
    if with_plain < _LEAST_PLAIN_AGREEMENT or is_like_them or among < with_plain + _LEAST_LEAD:
        return []
    return [plain, *shown]


def _mean_overlap(one: Tensor, others: Sequence[Tensor]) -> float:
    """Return the mean IoU of the cells that one answer and each of the others fill."""
    return sum(_overlap(one > _LIKELY, other > _LIKELY) for other in others) / len(others)


def _overlap(one: Tensor, other: Tensor) -> float:
    return float((one & other).sum()) / max(float((one | other).sum()), 1.0)
