"""Ask the shape network about one object.

P is voxelized, its mirror images are chosen, the network is asked about P in several places and
scales of the grid, and the logits of cells that lie beside a whole outline are lowered.

Conventions
-----------
* Half of the answers that are averaged are given with the prompt and half without. For objects that
  the network has not learned from, what a word adds is as often wrong as right, and answers with
  and without the prompt make different errors.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gscomplete.shape.ask import ask, mean_answer
from gscomplete.shape.mirror_plane import Mirror, MirrorPlane
from gscomplete.shape.network import ShapeCompleter, ShapeOutput
from gscomplete.shape.outline.lattice import off_lattice
from gscomplete.shape.outline.one_view import beside_scan, is_scan
from gscomplete.shape.outline.scorer import MOST_LOGITS, doubts_beside_outlines
from gscomplete.shape.partial_voxels import PartialVoxels, ShapeInputs, voxelize_partial
from gscomplete.shape.placements import mean_over_placements
from gscomplete.shape.symmetry_choice import choose_symmetries
from gscomplete.shape.voxels import CELLS, cell_centers
from gscomplete.splats import Splats
from gscomplete.util.arrays import Float32Array
from gscomplete.util.stages import stage
from gscomplete.views import ViewDistribution

_EMPTY_LOGIT = -4.0
"""Cells with a smaller logit count as empty at every level that is in use."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """The network's answer about one object."""

    voxels: PartialVoxels
    inputs: ShapeInputs
    """The network's input."""
    output: ShapeOutput
    """Its answer, for a batch of one: the mean over placements."""
    in_frame: Tensor  # [1, C, C, C]
    """Logits of its answer in the object frame alone, which answers to known shapes are compared
    with: they are given in no other placement."""
    symmetry_score: float
    """Score of the first mirror image; see ``symmetry_choice.Choice``."""
    ends_in_plane: bool
    """Whether P was cut along a plane, as far as ``framing.cut_plane`` finds."""
    prompt_share: float | None
    """Share of the cells filled with or without the prompt that only one of the two fills; None =
    there is no prompt."""
    added: Float32Array | None = None  # [len(benefit.OF_ANSWERS)]
    """What all answers add to P; None = the mirror image was given."""

    def without_copies(self) -> Prediction:
        """Return the prediction as one whose mirror image counts as wrong.

        P's own splats are not mirrored then, and the surface, which may follow that image, needs
        the stricter level (``assemble``).
        """
        return dataclasses.replace(self, symmetry_score=0.0)


def predict(
    model: ShapeCompleter,
    partial: Splats,
    distribution: ViewDistribution,
    tokens: Tensor,  # [L]
    *,
    no_tokens: Tensor,  # [L]
    ends_in_plane: bool,
    bfloat16: bool = False,
    mirror_plane: Mirror = "guess",
    captured: bool = False,
) -> Prediction:
    """Look at P, choose its mirror images, and ask the network.

    Args:
        model: in evaluation mode, on the CPU.
        partial: P in the object frame.
        distribution: V.
        tokens: the prompt.
        no_tokens: tokens that stand for no prompt.
        ends_in_plane: whether P was cut along a plane, as far as ``framing.cut_plane`` finds.
        bfloat16: whether the network computes in bfloat16.
        mirror_plane: plane of symmetry whose image is shown first.
        captured: whether P was trained from photos and nothing was cut off it.
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
        asked = model, choice.inputs
        first = choice.answer
        if first is None:
            first = ask(*asked, tokens, bfloat16=bfloat16)
        answer = mean_answer(*asked, (tokens, no_tokens), first=first, bfloat16=bfloat16)
        share = None
        if not torch.equal(tokens, no_tokens):
            without = ask(*asked, no_tokens, bfloat16=bfloat16)
            change = (without.occupancy - first.occupancy) / 2
            share = differing_share(answer.occupancy, answer.occupancy + change)
        given = answer, choice.inputs, partial, distribution, (tokens, no_tokens)
        mean = mean_over_placements(model, *given, bfloat16=bfloat16)
    output = mean
    if not isinstance(mirror_plane, MirrorPlane):
        with stage("outlines"):
            about = mean, voxels, distribution
            output = _doubted_beside(*about, ends_in_plane=ends_in_plane, captured=captured)
    in_frame = answer.occupancy - (mean.occupancy - output.occupancy)
    inputs, score = choice.inputs, choice.symmetry_score
    return Prediction(voxels, inputs, output, in_frame, score, ends_in_plane, share, choice.added)


def _doubted_beside(
    answer: ShapeOutput,
    voxels: PartialVoxels,
    distribution: ViewDistribution,
    *,
    ends_in_plane: bool,
    captured: bool,
) -> ShapeOutput:
    """Lower the logits of cells outside outlines of P that are the object's, and in P's holes."""
    logits = answer.occupancy.flatten()
    possible = (logits > _EMPTY_LOGIT).nonzero()[:, 0]
    places = cell_centers(CELLS).reshape(-1, 3)[possible.numpy()]
    points, doubts = voxels.positions, np.zeros(len(places), np.float32)
    one_view = is_scan(voxels.shown_at_once, ends_in_plane)
    if not one_view:
        doubts = doubts_beside_outlines(
            points,
            distribution,
            places,
            ends_in_plane=ends_in_plane,
            captured=captured,
        )
    if not ends_in_plane:
        doubts[beside_scan(points, distribution, places)] = MOST_LOGITS
    toward_c = distribution.direction()
    doubts[off_lattice(points, toward_c, places, is_scan=one_view)] = MOST_LOGITS
    lowered = logits.clone()
    lowered[possible] -= torch.from_numpy(doubts)
    return dataclasses.replace(answer, occupancy=lowered.reshape(answer.occupancy.shape))


def differing_share(
    one: Tensor,  # logits
    other: Tensor,  # logits, of the same shape
) -> float:  # in [0, 1]
    """Return the share of the cells filled by at least one of two answers that only one fills."""
    either = int(((one > 0) | (other > 0)).sum())
    return int(((one > 0) != (other > 0)).sum()) / max(either, 1)
