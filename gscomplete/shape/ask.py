"""Questions to the shape network about one object, in one orientation or averaged over some.

Conventions
-----------
* The network is not told which way an object faces, so the same object turned by quarter turns
  about z, or mirrored, should get the same answer. The mean of a few such answers, each turned
  back, is better than any one of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from gscomplete.networks.precision import cpu_precision
from gscomplete.shape.network import ShapeCompleter, ShapeOutput
from gscomplete.shape.partial_voxels import ShapeInputs

ORIENTATIONS = 2
"""How many orientations the answer is averaged over. There are eight, four quarter turns with and
without a mirroring; averaging over all of them is no better."""


@torch.no_grad()
def ask(
    model: ShapeCompleter,
    inputs: ShapeInputs,
    tokens: Tensor,  # [L]
    orientation: int = 0,  # 0 to 7
    *,
    bfloat16: bool = False,
) -> ShapeOutput:
    """Ask the network about one object in one orientation.

    Args:
        model: in evaluation mode, on the CPU.
        inputs: the network's inputs.
        tokens: the prompt.
        orientation: in which the object is given: quarter turns, plus 4 if it is mirrored. The
            answer is turned back.
        bfloat16: whether the network runs in bfloat16.

    Returns:
        The answer for a batch of one.
    """
    volumes = torch.from_numpy(inputs.volumes)[None]
    evidence = torch.from_numpy(inputs.evidence)[None]
    scores = torch.from_numpy(inputs.scores)[None]
    return answer_in(model, volumes, evidence, scores, tokens[None], orientation, bfloat16=bfloat16)


def mean_answer(
    model: ShapeCompleter,
    inputs: ShapeInputs,
    prompts: Sequence[Tensor],  # [L] each
    *,
    first: ShapeOutput | None = None,
    bfloat16: bool = False,
) -> ShapeOutput:
    """Ask the network about one object in as many orientations as there are prompts.

    Args:
        model: in evaluation mode, on the CPU.
        inputs: the network's inputs.
        prompts: one for each orientation, at most eight.
        first: the answer to the first prompt, if the network has given it already.
        bfloat16: whether the network runs in bfloat16.

    Returns:
        The answer for a batch of one.
    """
    answers = [] if first is None else [first]
    for orientation in range(len(answers), len(prompts)):
        answers.append(ask(model, inputs, prompts[orientation], orientation, bfloat16=bfloat16))
    return mean_of(answers)


def mean_of(answers: list[ShapeOutput]) -> ShapeOutput:
    """Average answers, in their order."""
    parts = [
        sum(columns[1:], start=columns[0]) / len(answers)
        for columns in zip(*((a.occupancy, a.colors, a.sources) for a in answers), strict=True)
    ]
    return ShapeOutput(*parts)


def answer_in(
    model: ShapeCompleter,
    volumes: Tensor,  # [B, SOURCES, 4, C, C, C]
    evidence: Tensor,  # [B, 3, C/2, C/2, C/2]
    scores: Tensor,  # [B, COPIES]
    tokens: Tensor,  # [B, L]
    orientation: int,  # 0 to 7
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
