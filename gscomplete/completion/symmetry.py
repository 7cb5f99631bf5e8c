"""A better guess than nothing for the first step: P again, turned or mirrored.

Most objects are symmetric about an upright plane or axis, so part of what is missing is there,
elsewhere. Candidates are turns about z and mirror images through upright planes near the centre. A
candidate is good when its copy of P lies where P is not (novelty), and bad when it shows from V,
beside P (protrusion) or in front of P (occlusion), or leaves the object frame's box. The copy is
only where new splats start; the prior and the preservation loss decide what becomes of them. The
paper starts from a sphere.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.completion.randomness import generator_for
from gscomplete.render import render
from gscomplete.splats import Splats, concatenate
from gscomplete.splats.filters import thinned
from gscomplete.splats.transform import multiply_quaternions, quaternion_from_rotation
from gscomplete.views import ViewDistribution

_TURNS_DEG = (90.0, 180.0, 270.0)
_PLANES = 12
_OFFSETS = (-0.12, -0.06, 0.0, 0.06, 0.12)
_SCORED_SPLATS = 2000
_SCORED_PX = 32
_SCORED_VIEWS = 6


@dataclass(frozen=True, slots=True)
class SymmetrySettings:
    """How candidates are judged; lengths in object sizes."""

    new_distance: float = 0.04
    """A copied splat at least this far from every splat of P is new."""
    front_tolerance: float = 0.03
    """A copied surface this much nearer than P's occludes it."""
    protrusion_weight: float = 3.0
    """Against novelty (share of the copy's splats): area beside P, per area of P."""
    occlusion_weight: float = 3.0
    """Against novelty: area in front of P, per area of P."""
    outside_weight: float = 1.0
    """Against novelty: share of the copy outside the object frame's box, where the whole object
    is believed to be."""
    box_tolerance: float = 0.03
    """The box is this much larger on every side."""
    min_score: float = 0.15
    """Below this no candidate is believed."""


@dataclass(frozen=True, slots=True)
class Symmetry:
    """A map x -> matrix x + shift that may take the object to itself."""

    name: str
    matrix: Tensor  # [3, 3] orthogonal
    shift: Tensor  # [3]
    score: float
    novelty: float

    def apply(self, splats: Splats) -> Splats:
        """Return the turned or mirrored splats; colours are taken as they are seen, SH degree 0.

        A mirrored splat has its axes mirrored: the reflection is absorbed by the axes' signs, so
        a quaternion remains.
        """
        turned = splats.with_sh_degree(0)
        rotation = self.matrix if torch.linalg.det(self.matrix) > 0 else -self.matrix
        return dataclasses.replace(
            turned,
            means=splats.means @ self.matrix.T + self.shift,
            quaternions=_turn(rotation, splats.quaternions),
        )


def best_symmetry(
    partial: Splats,
    distribution: ViewDistribution,
    seed: int,
    settings: SymmetrySettings | None = None,
) -> Symmetry | None:
    """Return the most believable symmetry of P in the object frame, or None.

    Args:
        partial: P in the object frame.
        distribution: V.
        seed: of the run; chooses the splats that candidates are judged by.
        settings: knobs; None = defaults.
    """
    chosen = settings or SymmetrySettings()
    few = thinned(partial, _SCORED_SPLATS, _draw(seed)).with_sh_degree(0)
    cameras = distribution.cameras(distribution.low_discrepancy(_SCORED_VIEWS), _SCORED_PX)
    with torch.no_grad():
        alone = render(few, cameras)
        area = float(alone.alpha.sum())
        if area <= 0:
            return None
        best = None
        for candidate in _candidates():
            copy = candidate.apply(few)
            distance = torch.cdist(copy.means, few.means).amin(dim=1)
            novelty = float((distance > chosen.new_distance).float().mean())
            if best is not None and novelty <= best.score:
                continue
            both = render(concatenate([few, copy]), cameras)
            protrusion = float((both.alpha - alone.alpha).clamp_min(0).sum()) / area
            nearer = alone.depth - both.depth > chosen.front_tolerance
            occlusion = float((alone.alpha * nearer).sum()) / area
            score = novelty - chosen.protrusion_weight * protrusion
            score -= chosen.occlusion_weight * occlusion
            beyond = (copy.means.abs() > 0.5 + chosen.box_tolerance).any(dim=1)
            score -= chosen.outside_weight * float(beyond.float().mean())
            if score >= chosen.min_score and (best is None or score > best.score):
                best = dataclasses.replace(candidate, score=score, novelty=novelty)
    return best


def symmetric_splats(
    partial: Splats, symmetry: Symmetry, count: int, seed: int, new_distance: float = 0.02
) -> Splats:
    """Return at most ``count`` splats of the copy of P that do not lie on P, widened to cover."""
    few = thinned(partial, _SCORED_SPLATS, _draw(seed))
    copy = symmetry.apply(thinned(partial, 4 * count, _draw(seed)))
    nearest = torch.cat([torch.cdist(m, few.means).amin(1) for m in copy.means.split(4096)])
    return thinned(copy.select(nearest > new_distance), count, _draw(seed))


def _draw(seed: int) -> torch.Generator:
    """Return the generator that chooses splats to judge and to copy."""
    return generator_for(seed, 0, "thinned")


def _candidates() -> list[Symmetry]:
    """List turns about z, and mirror images through upright planes at and beside the centre."""
    found = []
    for degrees in _TURNS_DEG:
        angle = math.radians(degrees)
        cos, sin = math.cos(angle), math.sin(angle)
        matrix = torch.tensor([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        name = f"turned by {degrees:g} degrees about the upright axis"
        found.append(Symmetry(name, matrix, torch.zeros(3), 0.0, 0.0))
    for index in range(_PLANES):
        degrees = 180.0 * index / _PLANES
        angle = math.radians(degrees)
        normal = torch.tensor([math.cos(angle), math.sin(angle), 0.0])
        matrix = torch.eye(3) - 2 * torch.outer(normal, normal)
        for offset in _OFFSETS:
            name = f"mirrored through the upright plane facing azimuth {degrees:g}, {offset:+g}"
            found.append(Symmetry(name, matrix, 2 * offset * normal, 0.0, 0.0))
    return found


def _turn(rotation: Tensor, quaternions: Tensor) -> Tensor:  # [3, 3], [N, 4] -> [N, 4]
    """Rotate quaternions by a proper rotation matrix."""
    turn = quaternion_from_rotation(rotation.double()).to(quaternions)
    return multiply_quaternions(turn.expand_as(quaternions), quaternions)
