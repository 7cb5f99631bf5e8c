"""The shape network's answer for one object, averaged over the ways it may be asked.

Conventions
-----------
* The network is not told which way an object faces, so the same object turned by quarter turns
  about z, or mirrored, should get the same answer. The mean of the answers, carried back, is better
  than any one of them. (Frames moved by half a cell or a whole one are not: thin parts blur.)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.shape.bank.fit import FittedShape
from gscomplete.shape.mirror_plane import Mirror
from gscomplete.shape.network import ShapeCompleter, ShapeOutput, cpu_precision
from gscomplete.shape.partial_voxels import PartialVoxels, ShapeInputs, voxelize_partial
from gscomplete.shape.symmetry_choice import choose_symmetries
from gscomplete.splats import Splats
from gscomplete.util.stages import stage
from gscomplete.views import ViewDistribution

ORIENTATIONS = 8
"""Four quarter turns, each mirrored or not."""
_SHAPE_ORIENTATIONS = 2
"""Of these, with each known shape."""
_LEAST_AGREEMENT = 0.5
"""Of the answers to known shapes among themselves ..."""
_LEAST_LEAD = 0.05
"""... and how much more that is than with the answer to none."""
_LEAST_PLAIN_AGREEMENT = 0.5
"""Below it the answer to none does not count beside them."""
_LIKELY = -0.5
"""Cells are compared where they are filled from this logit on."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """The network's answer about one object."""

    voxels: PartialVoxels
    seen: ShapeInputs
    """What the network was given of P."""
    output: ShapeOutput
    """Its answer, for a batch of one."""
    symmetry_score: float
    """Of the first mirror image; see ``symmetry_choice.Choice``."""
    prompt_share: float | None
    """Of the cells that are filled with the prompt or without it, how many are filled in one of the
    two alone; None = no prompt."""
    known: tuple[FittedShape, ...]
    """Known shapes that the answer heeds."""


def predict(
    model: ShapeCompleter,
    partial: Splats,
    distribution: ViewDistribution,
    tokens: Tensor,  # [L]
    *,
    ends_in_plane: bool,
    no_tokens: Tensor | None = None,  # [L]
    bfloat16: bool = False,
    mirror_plane: Mirror = "guess",
    known: Sequence[FittedShape] = (),
    known_alone: bool = False,
) -> Prediction:
    """Look at P, choose its mirror images, and ask the network.

    Args:
        model: in evaluation mode, on the CPU.
        partial: P in the object frame.
        distribution: V.
        tokens: the prompt.
        ends_in_plane: whether P was cut along a plane (``framing.cut_plane``).
        no_tokens: no prompt, to tell what ``tokens`` change; None = it is not asked.
        bfloat16: precision of the network.
        mirror_plane: which plane of symmetry to show first.
        known: shapes in place, the best first; see :func:`voices_that_count`.
        known_alone: where they count, the answer without them does not.
    """
    with stage("voxels"):
        voxels = voxelize_partial(partial, distribution)
    with stage("mirror images"):
        choice = choose_symmetries(
            model,
            voxels,
            tokens,
            ends_in_plane=ends_in_plane,
            bfloat16=bfloat16,
            mirror_plane=mirror_plane,
        )
    with stage("network"):
        seen = voxels.with_copies(choice.symmetries)
        answers = _answers(model, seen, tokens, ORIENTATIONS, bfloat16=bfloat16)
        share = None
        if no_tokens is not None and not torch.equal(tokens, no_tokens):
            (without,) = _answers(model, seen, no_tokens, 1, bfloat16=bfloat16)
            share = differing_share(answers[0].occupancy, without.occupancy)
        answer = mean_answer(answers)
        used: tuple[FittedShape, ...] = ()
        if len(known) > 1:
            shown = [
                _shown(model, voxels.with_shape(seen, shape.points), tokens, bfloat16=bfloat16)
                for shape in known
            ]
            voices = voices_that_count(shown, answer.occupancy, shapes_alone=known_alone)
            if voices:
                occupancy = sum(voices[1:], start=voices[0]) / len(voices)
                answer, used = dataclasses.replace(answer, occupancy=occupancy), tuple(known)
    return Prediction(voxels, seen, answer, choice.symmetry_score, share, used)


def _shown(
    model: ShapeCompleter,
    seen: ShapeInputs,
    tokens: Tensor,  # [L]
    *,
    bfloat16: bool,
) -> Tensor:  # [1, C, C, C]
    """Return what the network fills when it is shown a known shape."""
    answers = _answers(model, seen, tokens, _SHAPE_ORIENTATIONS, bfloat16=bfloat16)
    return mean_answer(answers).occupancy


def voices_that_count(
    shown: Sequence[Tensor],  # logits, answers to known shapes, the best first
    plain: Tensor,  # logits, the answer to none
    *,
    shapes_alone: bool = False,
) -> list[Tensor]:
    """Return the answers that the guess is the mean of; none = the plain one as it is.

    Each answer to a known shape is often wrong. They count where they agree, and more than with the
    plain one: where that is like them it has P's own mirror images on its side. Where it is very
    unlike them they count alone.

    Args:
        shown: answers to known shapes.
        plain: answer to none.
        shapes_alone: leave the plain one out whatever it is like.
    """
    among, with_plain = _mean_overlap(shown[0], shown[1:]), _mean_overlap(plain, shown)
    if among < _LEAST_AGREEMENT or among < with_plain + _LEAST_LEAD:
        return []
    if shapes_alone or with_plain < _LEAST_PLAIN_AGREEMENT:
        return list(shown)
    return [plain, *shown]


def _mean_overlap(one: Tensor, others: Sequence[Tensor]) -> float:
    """Return the mean overlap (IoU) of the cells that answers fill, as counted here."""
    shares = [differing_share_of(one > _LIKELY, other > _LIKELY) for other in others]
    return 1.0 - sum(shares) / len(shares)


def differing_share(
    one: Tensor,  # logits
    other: Tensor,  # logits, of the same shape
) -> float:  # in [0, 1]
    """Return how many of the cells that either fills are filled by one alone."""
    return differing_share_of(one > 0, other > 0)


def differing_share_of(one: Tensor, other: Tensor) -> float:  # bool, of one shape; in [0, 1]
    """Return how many of the cells that either marks are marked by one alone."""
    return int((one != other).sum()) / max(int((one | other).sum()), 1)


def predict_occupancy(
    model: ShapeCompleter,
    seen: ShapeInputs,
    tokens: Tensor,  # [L]
    *,
    orientations: int = ORIENTATIONS,
    bfloat16: bool = False,
) -> ShapeOutput:
    """Ask the network about one object.

    Args:
        model: in evaluation mode, on the CPU.
        seen: what it is given.
        tokens: the prompt.
        orientations: how many of the eight are asked and averaged.
        bfloat16: precision of the network.

    Returns:
        The answer for a batch of one.
    """
    return mean_answer(_answers(model, seen, tokens, orientations, bfloat16=bfloat16))


def mean_answer(answers: list[ShapeOutput]) -> ShapeOutput:
    """Average answers, in their order."""
    parts = [
        sum(columns[1:], start=columns[0]) / len(answers)
        for columns in zip(*((a.occupancy, a.colors, a.sources) for a in answers), strict=True)
    ]
    return ShapeOutput(*parts)


@torch.no_grad()
def _answers(
    model: ShapeCompleter,
    seen: ShapeInputs,
    tokens: Tensor,  # [L]
    orientations: int,
    *,
    bfloat16: bool,
) -> list[ShapeOutput]:
    """Return the network's answers to the first orientations, each turned back."""
    volumes = torch.from_numpy(seen.volumes)[None]
    evidence = torch.from_numpy(seen.evidence)[None]
    scores = torch.from_numpy(seen.scores)[None]
    found = []
    for index in range(orientations):
        turns, mirror = index % 4, index >= 4
        with cpu_precision(bfloat16=bfloat16):
            out = model(
                turned(volumes, turns, mirror),
                turned(evidence, turns, mirror),
                scores,
                tokens[None],
            )
        parts = (out.occupancy, out.colors, out.sources)
        found.append(ShapeOutput(*(turned_back(part.float(), turns, mirror) for part in parts)))
    return found


def turned(volume: Tensor, turns: int, mirror: bool) -> Tensor:  # [..., x, y, z]
    """Turn a volume by quarter turns about z, then mirror x."""
    volume = torch.rot90(volume, turns, dims=(-3, -2))
    return volume.flip(-3) if mirror else volume


def turned_back(volume: Tensor, turns: int, mirror: bool) -> Tensor:  # [..., x, y, z]
    """Undo :func:`turned`."""
    volume = volume.flip(-3) if mirror else volume
    return torch.rot90(volume, -turns, dims=(-3, -2))
