"""Which mirror images of P the shape network is given: those consistent with its own answers.

Planes are proposed from P alone. The network knows more about objects, so it is asked once per
likely plane and once without any, and the answer that ``planes.answer_scorer`` ranks first is
taken. If P ends in a plane, something beyond it is missing, so the question without any is left
out.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.shape.ask import ask
from gscomplete.shape.benefit import features_of_answers
from gscomplete.shape.mirror_plane import Mirror, MirrorPlane
from gscomplete.shape.network import ShapeCompleter, ShapeOutput
from gscomplete.shape.partial_voxels import PartialVoxels, ShapeInputs
from gscomplete.shape.planes.answer_scorer import (
    OF_ANSWER,
    Answers,
    answer_features,
    packaged_answer_scorer,
)
from gscomplete.shape.planes.proposals import candidate_planes
from gscomplete.shape.symmetry import SymmetryMap, mirror, no_symmetries
from gscomplete.shape.voxels import CELLS
from gscomplete.util.arrays import Float32Array
from gscomplete.util.same_bits import fixed_sigmoid
from gscomplete.util.stages import stage

CANDIDATES = 8


@dataclass(frozen=True, slots=True)
class Choice:
    """The inputs chosen for the network."""

    inputs: ShapeInputs
    symmetry_score: float
    """Score of the first mirror image by the network's answer; 0 = there is none, 1 = a user chose
    it."""
    answer: ShapeOutput | None = None
    """The network's answer to these inputs, for a batch of one; None = it was not asked."""
    added: Float32Array | None = None  # [len(benefit.OF_ANSWERS)]
    """Features of what all its answers add to P; None = it was not asked."""


@dataclass(frozen=True, slots=True)
class AskedPlanes:
    """The questions about likely planes, in the order in which the planes were proposed."""

    answers: Answers
    shown: tuple[tuple[SymmetryMap, ...], ...]
    """The mirror images in each question."""
    outputs: tuple[ShapeOutput, ...]
    """The full answers, for batches of one."""


@dataclass(frozen=True, slots=True)
class ScoredPlanes:
    """Likely planes, ranked by the network's answers to them, the best first."""

    planes: tuple[SymmetryMap, ...]
    symmetry_scores: tuple[float, ...]
    """Score of each plane by the network's answer to it."""
    none_is_best: bool
    """Whether the answer without any mirror image is ranked first."""
    inputs: ShapeInputs
    """Inputs of the answer ranked first: with the best plane, or without mirror image."""
    answer: ShapeOutput
    """The answer ranked first."""
    added: Float32Array  # [len(benefit.OF_ANSWERS)]
    """Features of what all answers add to P."""

    def distinct(self, points: Float32Array) -> tuple[SymmetryMap, ...]:  # points [N, 3] of P
        """Return the planes that are not like any plane before them."""
        found: list[SymmetryMap] = []
        for plane in self.planes:
            if not any(plane.is_like(other, points) for other in found):
                found.append(plane)
        return tuple(found)


def choose_symmetries(
    model: ShapeCompleter,
    voxels: PartialVoxels,
    tokens: Tensor,  # [L]
    *,
    ends_in_plane: bool,
    bfloat16: bool = False,
    mirror_plane: Mirror = "guess",
) -> Choice:
    """Choose the mirror images that the network is given.

    Args:
        model: in evaluation mode, on the CPU.
        voxels: P.
        tokens: the prompt.
        ends_in_plane: whether P was cut along a plane, as far as found (``framing.cut_plane``).
        bfloat16: whether the network runs in bfloat16.
        mirror_plane: the plane of the first mirror image, "none", or "guess" = chosen here.
    """
    if mirror_plane == "none":
        return Choice(voxels.with_copies(no_symmetries()), 0.0)
    if isinstance(mirror_plane, MirrorPlane):
        planes = candidate_planes(voxels, CANDIDATES, bfloat16=bfloat16)
        angle = math.radians(mirror_plane.azimuth_deg)
        given = mirror(angle, mirror_plane.offset, planes[0].score)
        return Choice(voxels.with_copies(voxels.input_symmetries([given, *planes], 0)), 1.0)
    asked = score_planes(model, voxels, tokens, ends_in_plane=ends_in_plane, bfloat16=bfloat16)
    score = 0.0 if asked.none_is_best else asked.symmetry_scores[0]
    return Choice(asked.inputs, score, asked.answer, asked.added)


def score_planes(
    model: ShapeCompleter,
    voxels: PartialVoxels,
    tokens: Tensor,  # [L]
    *,
    ends_in_plane: bool,
    bfloat16: bool = False,
) -> ScoredPlanes:
    """Rank the likely planes by the network's answers; arguments as :func:`choose_symmetries`."""
    asked = ask_about_planes(model, voxels, tokens, ends_in_plane=ends_in_plane, bfloat16=bfloat16)
    answers, count = asked.answers, len(asked.answers.planes)
    features = answer_features(answers)
    scores = features[:, OF_ANSWER.index("symmetry_score")]
    rank = torch.from_numpy(packaged_answer_scorer()(features))
    ranked = rank.argsort(descending=True, stable=True).tolist()
    order = [k for k in ranked if k < count]
    return ScoredPlanes(
        tuple(answers.planes[k] for k in order),
        tuple(float(scores[k]) for k in order),
        ranked[0] == count,
        voxels.with_copies(asked.shown[ranked[0]]),
        asked.outputs[ranked[0]],
        features_of_answers(answers, ranked[0]),
    )


@torch.no_grad()
def ask_about_planes(
    model: ShapeCompleter,
    voxels: PartialVoxels,
    tokens: Tensor,  # [L]
    *,
    ends_in_plane: bool,
    bfloat16: bool = False,
) -> AskedPlanes:
    """Ask the network about every likely plane; arguments as :func:`choose_symmetries`."""
    with stage("planes"):
        planes = candidate_planes(voxels, CANDIDATES, bfloat16=bfloat16)
    count = len(planes)
    shown = [_symmetries_with_first(voxels, planes, k) for k in range(count)]
    if not ends_in_plane:
        shown.append(no_symmetries())
    copies = torch.empty(count, *(CELLS,) * 3)
    outputs = []
    for k, symmetries in enumerate(shown):  # one by one, so that a question fits into the caches
        inputs = voxels.with_copies(symmetries)
        outputs.append(ask(model, inputs, tokens, bfloat16=bfloat16))
        if k < count:
            copies[k] = torch.from_numpy(inputs.volumes[1, 0])
    answers = Answers(
        tuple(planes),
        copies,
        fixed_sigmoid(torch.cat([output.occupancy for output in outputs])),
        torch.from_numpy(voxels.volume[0]),
        voxels.shown_at_once,
        ends_in_plane,
    )
    return AskedPlanes(answers, tuple(shown), tuple(outputs))


def _symmetries_with_first(
    voxels: PartialVoxels, planes: list[SymmetryMap], index: int
) -> tuple[SymmetryMap, ...]:  # COPIES
    """Show one plane first, as if it were the likeliest."""
    as_likely = list(planes)
    as_likely[index] = dataclasses.replace(planes[index], score=planes[0].score)
    return voxels.input_symmetries(as_likely, index)
