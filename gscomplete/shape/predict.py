"""The shape network's answer for one object, averaged over the ways it may be asked.

Conventions
-----------
* The network is not told which way an object faces, so the same object turned by quarter turns
  about z, or mirrored, should get the same answer. The mean of a few answers, carried back, is
  better than any one of them. (Frames moved by half a cell or more are not: thin parts blur.)
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.shape.mirror_plane import Mirror
from gscomplete.shape.network import ShapeCompleter, ShapeOutput, cpu_precision
from gscomplete.shape.partial_voxels import PartialVoxels, ShapeInputs, voxelize_partial
from gscomplete.shape.symmetry_choice import choose_symmetries
from gscomplete.splats import Splats
from gscomplete.util.stages import stage
from gscomplete.views import ViewDistribution

ORIENTATIONS = 2
"""Of the eight, which are four quarter turns, each mirrored or not. All eight are no better."""


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
) -> Prediction:
    """Look at P, choose its mirror images, and ask the network.

    Args:
        model: in evaluation mode, on the CPU.
        partial: P in the object frame.
        distribution: V.
        tokens: the prompt.
        ends_in_plane: whether P was cut along a plane, as far as found (``framing.cut_plane``).
        no_tokens: no prompt, to tell what ``tokens`` change; None = it is not asked.
        bfloat16: precision of the network.
        mirror_plane: which plane of symmetry to show first.
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
    return Prediction(voxels, seen, mean_answer(answers), choice.symmetry_score, share)


def differing_share(
    one: Tensor,  # logits
    other: Tensor,  # logits, of the same shape
) -> float:  # in [0, 1]
    """Return how many of the cells that either fills are filled by one alone."""
    either = int(((one > 0) | (other > 0)).sum())
    return int(((one > 0) != (other > 0)).sum()) / max(either, 1)


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
    given = volumes, evidence, scores, tokens[None]
    return [answer_in(model, *given, index, bfloat16=bfloat16) for index in range(orientations)]


def answer_in(
    model: ShapeCompleter,
    volumes: Tensor,  # [B, SOURCES, 4, C, C, C]
    evidence: Tensor,  # [B, 3, C/2, C/2, C/2]
    scores: Tensor,  # [B, COPIES]
    tokens: Tensor,  # [B, L]
    orientation: int,  # of the eight
    *,
    bfloat16: bool,
) -> ShapeOutput:
    """Ask the network about objects in one orientation, and turn the answer back."""
    turns, mirror = orientation % 4, orientation >= 4
    with cpu_precision(bfloat16=bfloat16):
        out = model(turned(volumes, turns, mirror), turned(evidence, turns, mirror), scores, tokens)
    parts = (out.occupancy, out.colors, out.sources)
    return ShapeOutput(*(turned_back(part.float(), turns, mirror) for part in parts))


def turned(volume: Tensor, turns: int, mirror: bool) -> Tensor:  # [..., x, y, z]
    """Turn a volume by quarter turns about z, then mirror x."""
    volume = torch.rot90(volume, turns, dims=(-3, -2))
    return volume.flip(-3) if mirror else volume


def turned_back(volume: Tensor, turns: int, mirror: bool) -> Tensor:  # [..., x, y, z]
    """Undo :func:`turned`."""
    volume = volume.flip(-3) if mirror else volume
    return torch.rot90(volume, -turns, dims=(-3, -2))
