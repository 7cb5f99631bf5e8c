"""The shape network's answer for one object, averaged over the orientations it may be asked in.

Conventions
-----------
* The network is not told which way an object faces, so the same object turned by quarter turns
  about z, or mirrored, should get the same answer; the mean of the answers, turned back, is better
  than any one of them.
"""

from __future__ import annotations

import contextlib

import torch
from torch import Tensor

from gscomplete.priors.embedded.shape.inputs import ShapeInputs
from gscomplete.priors.embedded.shape.model import ShapeCompleter, ShapeOutput

ORIENTATIONS = 8
"""Four quarter turns, each mirrored or not."""


@torch.no_grad()
def predict_whole(
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
        seen: what it is shown.
        tokens: the prompt.
        orientations: how many of the eight are asked and averaged.
        bfloat16: precision of the network.

    Returns:
        The answer for a batch of one.
    """
    volumes = torch.from_numpy(seen.volumes)[None]
    evidence = torch.from_numpy(seen.evidence)[None]
    scores = torch.from_numpy(seen.scores)[None]
    sums: list[Tensor] = []
    precision: contextlib.AbstractContextManager[None] = torch.autocast(
        "cpu", torch.bfloat16, enabled=bfloat16
    )
    for index in range(orientations):
        turns, mirror = index % 4, index >= 4
        with precision:
            out = model(
                turned(volumes, turns, mirror),
                turned(evidence, turns, mirror),
                scores,
                tokens[None],
            )
        parts = [
            turned_back(part.float(), turns, mirror)
            for part in (out.occupancy, out.colors, out.sources)
        ]
        sums = [a + b for a, b in zip(sums, parts, strict=True)] if sums else parts
    occupancy, colors, sources = (part / orientations for part in sums)
    return ShapeOutput(occupancy, colors, sources)


def turned(volume: Tensor, turns: int, mirror: bool) -> Tensor:  # [..., x, y, z]
    """Turn a volume by quarter turns about z, then mirror x."""
    volume = torch.rot90(volume, turns, dims=(-3, -2))
    return volume.flip(-3) if mirror else volume


def turned_back(volume: Tensor, turns: int, mirror: bool) -> Tensor:  # [..., x, y, z]
    """Undo :func:`turned`."""
    volume = volume.flip(-3) if mirror else volume
    return torch.rot90(volume, -turns, dims=(-3, -2))
