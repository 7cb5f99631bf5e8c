"""The shape network's answer for one object, averaged over the ways it may be asked.

Conventions
-----------
* The network is not told which way an object faces, so the same object turned by quarter turns
  about z, or mirrored, should get the same answer; nor is it told how good the guess of the frame
  is, so the same object moved and scaled a little should too. The mean of the answers, carried
  back, is better than any one of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.priors.embedded.shape.choice import choose_symmetries
from gscomplete.priors.embedded.shape.grid import CELLS, cell_centers, sample_volume
from gscomplete.priors.embedded.shape.inputs import ShapeInputs, look_at
from gscomplete.priors.embedded.shape.model import ShapeCompleter, ShapeOutput, cpu_precision
from gscomplete.splats import Splats
from gscomplete.splats.transform import Similarity, transform_splats
from gscomplete.views import ViewDistribution

ORIENTATIONS = 8
"""Four quarter turns, each mirrored or not."""


@dataclass(frozen=True, slots=True)
class FrameSettings:
    """Frames that the network is asked in."""

    count: int
    """How many, the given frame included."""
    shift: float = 0.015
    """Standard deviation of their origins, object sizes: half a fine cell. Answers of frames
    farther apart blur thin parts away."""
    log_scale: float = 0.03
    """Standard deviation of the logarithm of their sizes."""


def predict_over_frames(
    model: ShapeCompleter,
    partial: Splats,
    distribution: ViewDistribution,
    tokens: Tensor,  # [L]
    generator: torch.Generator,
    settings: FrameSettings,
    *,
    bfloat16: bool = False,
) -> tuple[ShapeInputs, ShapeOutput]:
    """Look at P, choose its mirror images, and ask the network in frames near the given one.

    Args:
        model: in evaluation mode, on the CPU.
        partial: P in the object frame.
        distribution: V.
        tokens: the prompt.
        generator: chooses the other frames.
        settings: which frames.
        bfloat16: precision of the network.

    Returns:
        What the network saw in the given frame, and the answer there for a batch of one: mean
        occupancy over all frames, colours of the given frame.
    """
    look = look_at(partial, distribution)
    symmetries = choose_symmetries(model, look, tokens, bfloat16=bfloat16)
    seen = look.with_copies(symmetries)
    output = predict_whole(model, seen, tokens, bfloat16=bfloat16)
    occupancy, count = output.occupancy, 1
    centers = torch.from_numpy(cell_centers(CELLS)).reshape(-1, 3)
    for moved in _other_frames(generator, settings):
        look = look_at(transform_splats(partial, moved), distribution)
        again = look.with_copies(tuple(s.in_frame(moved) for s in symmetries))
        answer = predict_whole(model, again, tokens, bfloat16=bfloat16).occupancy[0]
        there = moved.scale * centers + moved.translation.float()
        occupancy = occupancy + sample_volume(answer[None], there).reshape(1, *answer.shape)
        count += 1
    return seen, ShapeOutput(occupancy / count, output.colors, output.sources)


def _other_frames(generator: torch.Generator, settings: FrameSettings) -> Iterator[Similarity]:
    """Draw maps from the given frame to others."""
    for _ in range(settings.count - 1):
        draw = torch.randn(4, generator=generator, dtype=torch.float64)
        scale = math.exp(settings.log_scale * float(draw[3]))
        turn = torch.eye(3, dtype=torch.float64)
        yield Similarity(scale, turn, settings.shift * draw[:3])


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
    for index in range(orientations):
        turns, mirror = index % 4, index >= 4
        with cpu_precision(bfloat16=bfloat16):
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
