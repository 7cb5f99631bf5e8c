"""The guess of the complete object: P mirrored where consistent, the network's surface elsewhere.

Where P is part of a surface of revolution, P turned about its axis comes before the network's.

Conventions
-----------
* Lengths are in object sizes. What P does not have is called new. "Copies" are P's splats,
  mirrored.
* Copies are left out where something contradicts them: the views of V, the network's answer or
  known shapes of the prompt's noun. The last two can mark copies of a handle as a second handle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gscomplete.shape.bank.fit import FittedShape
from gscomplete.shape.evidence import Evidence, gather_evidence
from gscomplete.shape.mirror_plane import MirrorPlane
from gscomplete.shape.outline.lattice import seen_through
from gscomplete.shape.outline.one_view import is_scan
from gscomplete.shape.partial_voxels import PartialVoxels
from gscomplete.shape.predict import Prediction
from gscomplete.shape.surface.cover import (
    SurfaceSettings,
    is_missing,
    median_spacing,
    surface_splats,
)
from gscomplete.shape.surface.solid import SolidViews, is_known_all_round, solid_views
from gscomplete.shape.surface.turned import TurnedSurface
from gscomplete.shape.symmetry import SymmetryMap, mirror, mirror_image, plane_of
from gscomplete.shape.voxels import CELL_SIDE, missing_surface_share, sample_volume
from gscomplete.splats import Splats, concatenate
from gscomplete.splats.rotations import thinnest_axes
from gscomplete.splats.thinning import thinned
from gscomplete.views import ViewDistribution

_LEAST_SPACING, _MOST_SPACING = 0.0013, 0.02
"""Bounds of the spacing of the network's surface beside copies; ..."""
_SPACING_BESIDE = 0.66
"""... between them it is so many times the copies' own median spacing, which makes the surface a
little denser than they are."""
_MOST_LOOKED_AT = 20_000
"""Most splats of P that copies are compared with, to tell where P is."""
_SEAM_SPACINGS, _MOST_SEAM, _ONE_SIDED_COPY = 0.5, 0.01, 0.55
"""A copy beyond P's rim counts as new if it is at least so many of P's spacings from P, or the
second distance, and P's nearest splats are at least this one-sided; stricter limits leave a dark
line along a cut."""
_LEAST_COPY_LOGIT = -2.0
"""Copies in cells with a lower logit are left out, unless the plane is certain: given half a cow,
the network doubts the legs on the other side, because no view shows them."""
_DOUBTED_LOGIT = 0.0
"""Copies in cells with a lower logit are doubted: known shapes decide about them."""
_FEW_DOUBTED = 0.02
"""If a smaller share of the copies is doubted, known shapes are not asked."""
_FEWEST_KNOWN = 2
"""Fewer known shapes contradict nothing."""
_UNLIKE_KNOWN = 0.08
"""Known shapes contradict a doubted copy that is farther than this from all of them."""
_BESIDE, _OFF_KNOWN = 0.12, 0.03
"""Within the first distance of such a copy, they also contradict those doubted copies that are
farther than the second from all known shapes, ..."""
_OTHER_COLOR = 0.2
"""... and all copies of the contradicted ones' colour, if the median colours of contradicted and
other copies there differ by at least this (Euclidean, sRGB)."""
_MOST_IN_FRONT = 0.5
"""Splats that a larger share of the views finds in front of P are left out: they would hide P."""
_LEAST_SYMMETRY_SCORE = 0.75
"""Copies are used if the network's answer gives their plane at least this score; otherwise the
network's surface alone completes P."""
_LITTLE = 0.1
"""If P lacks a smaller share of the network's surface, copies would only double P's own splats. Of
the parts of 60 unseen objects, only complete ones lack less than .12."""
_LOGIT_BESIDE = 0.0
"""Cells count as filled from this logit on where the network's surface goes beside copies."""
_SYMMETRY_SCORES = (0.1, 0.3)
"""If the best plane scores less than the first, mirror images add nothing that the network
predicts: little is missing. From the second on the score no longer suggests that."""
_GAP_SPACINGS = 3.0
"""The network's surface closes gaps between P and copies that are wider than so many spacings."""
_NEARLY_ALL = 0.9
"""If at least this share of P's splats has a copy, copies may be all that is added
(``AssembleSettings.image_is_all``); where fewer are left, the others would have hidden P."""


@dataclass(frozen=True, slots=True)
class AssembleSettings:
    """How the first guess is put together."""

    count: int = 20_000
    """Most splats of the network's surface. Copies are not limited: there are as many as P has
    splats, because fewer, however wide, would let what lies behind them show through."""
    occupancy_threshold_low: float = -1.0
    """Without copies, cells count as filled from this logit on where much is missing, such as the
    whole far side of a scan. The network is never confident of thin walls there; the price of
    keeping them is some excess."""
    occupancy_threshold_high: float = 0.25
    """The same where little is missing, so that a complete P stays as it is. On 135 parts of 15
    real objects that no benchmark uses, using both levels raises IoU by .009 over -1 everywhere:
    by .023 on parts that lack little, by .001 on the others."""
    occupancy_threshold_piece: float = -0.5
    """The same where P is a piece cut off by a box or a plane, however much is missing. On 48 such
    parts of 29 validation objects, other than those it was chosen on, IoU is .009 above that of
    the other two levels."""
    shown_of_piece: float = 0.8
    """P is a piece if no single view shows more than this share of it; scans and captures show
    more of themselves at once."""
    threshold_missing_shares: tuple[float, float] = (0.2, 0.3)
    """Little is missing if no more than the first share of the network's surface lies beyond P's
    cells and their neighbours, much if at least the second does; between them the level is
    interpolated. Of this level and that of ``_SYMMETRY_SCORES`` the higher counts. (A wider
    neighbourhood would take scattered splats for a surface.)"""
    near_partial: float = 0.03
    """Without copies, surface this near to P's splats is P's own, as
    ``SurfaceSettings.near_partial`` says."""
    image_is_all: bool = False
    """Whether P was cut along the mirror plane. Then, if nearly all of P's splats have a copy, the
    copies are all that is added and the network's surface is not used."""
    reach: float = 1.5 * CELL_SIDE
    """With copies, surface this near to P's splats or to copies is theirs: the grid's cells blur
    the surface by as much."""


@dataclass(frozen=True, slots=True)
class AssembledSplats:
    """What completes one object."""

    splats: Splats
    """The new splats."""
    mirrored: int
    """How many of them are copies; these come first."""
    contradicted: int = 0
    """How many further copies were left out because known shapes contradict them."""


def assemble_splats(
    prediction: Prediction,
    partial: Splats,
    settings: AssembleSettings,
    generator: torch.Generator,
    known: Callable[[], Sequence[FittedShape]] = tuple,
    turned: TurnedSurface | None = None,
) -> AssembledSplats:
    """Return the new splats of one object.

    Args:
        prediction: the network's answer and what it was given.
        partial: P in the object frame.
        settings: knobs.
        generator: chooses where splats sit.
        known: finds known shapes that suit P; called only if the network doubts enough copies for
            known shapes to decide about them.
        turned: the surface of revolution that P is part of; None = there is none.
    """
    solid = where_solid(prediction, partial)
    copies, contradicted = mirrored_copies(prediction, partial, generator, known, solid)
    if copies is not None and settings.image_is_all and len(copies) >= _NEARLY_ALL * len(partial):
        return AssembledSplats(copies, len(copies), len(contradicted))
    covering = surface_settings(prediction, settings, copies)
    asked = prediction.output, prediction.inputs, partial, covering, generator
    surface = surface_splats(*asked, copies, turned, solid)
    if turned is None:
        surface = surface.select(~in_holes(surface, prediction.voxels))
    if copies is None:
        return AssembledSplats(surface, 0)
    if len(contradicted):
        surface = surface.select(~stands_off(known(), surface, contradicted))
    return AssembledSplats(concatenate([copies, surface]), len(copies), len(contradicted))


def where_solid(prediction: Prediction, partial: Splats) -> SolidViews | None:
    """Return where P shows solid surface; None = its surface is known from one side only."""
    shown, in_plane = prediction.voxels.shown_at_once, prediction.ends_in_plane
    if not is_known_all_round(partial, shown, ends_in_plane=in_plane):
        return None
    return solid_views(partial)


def mirrored_copies(
    prediction: Prediction,
    partial: Splats,
    generator: torch.Generator,
    known: Callable[[], Sequence[FittedShape]] = tuple,
    solid: SolidViews | None = None,
) -> tuple[Splats | None, Splats]:
    """Mirror P's splats through the first plane; leave out what P has or something contradicts.

    Arguments are those of :func:`assemble_splats`, and ``solid`` is ``where_solid``.

    Returns:
        The copies to add (None = P's splats are not to be mirrored, or no copy is left), and those
        left out because known shapes, and nothing else, contradict them.
    """
    if not is_mirrored_by_splats(prediction):
        return None, partial.select(torch.arange(0))
    copies = mirror_image(partial, prediction.inputs.symmetries[0])
    occupancy = prediction.output.occupancy.float()
    least_logit = -math.inf if _is_certain(prediction) else _LEAST_COPY_LOGIT
    copies = select_consistent(copies, occupancy, prediction.voxels.evidence, least_logit)
    doubted = sample_volume(occupancy, copies.means)[:, 0] < _DOUBTED_LOGIT
    against = torch.zeros_like(doubted)
    if float(doubted.sum()) > _FEW_DOUBTED * len(copies):
        against = contradicted_by(known(), copies, doubted)
    contradicted, copies = copies.select(against), copies.select(~against)
    copies = beyond(copies, partial, generator, solid)
    return copies if len(copies) else None, contradicted


def surface_settings(
    prediction: Prediction, settings: AssembleSettings, copies: Splats | None
) -> SurfaceSettings:
    """Return how the network's surface is covered, beside mirrored splats or alone."""
    if copies is None:
        return SurfaceSettings(
            settings.count,
            near_partial=settings.near_partial,
            filled_logit=_surface_logit(prediction, settings),
            rim_decides=not _is_certain(prediction),
        )
    beside = _SPACING_BESIDE * median_spacing(copies.means)
    return SurfaceSettings(
        settings.count,
        near_partial=settings.reach,
        gap_spacings=_GAP_SPACINGS,
        filled_logit=_LOGIT_BESIDE,
        least_spacing=min(max(beside, _LEAST_SPACING), _MOST_SPACING),
    )


def is_mirrored_by_splats(prediction: Prediction) -> bool:
    """Say whether the plane of symmetry is sure enough for P's own splats to be mirrored."""
    is_sure = prediction.symmetry_score >= _LEAST_SYMMETRY_SCORE
    return is_sure and _missing_share(prediction) >= _LITTLE


def _is_certain(prediction: Prediction) -> bool:
    """Say whether the plane is taken as given: a user chose it, or P was cut squarely along it."""
    return prediction.symmetry_score >= 1.0


def _missing_share(prediction: Prediction) -> float:  # in [0, 1]
    """Return how much of the network's surface P does not have."""
    partial = torch.from_numpy(prediction.voxels.volume[:1])
    return missing_surface_share(prediction.output.occupancy > 0, partial)


def _surface_logit(prediction: Prediction, settings: AssembleSettings) -> float:
    """Return the logit from which on cells count as filled (see ``AssembleSettings``)."""
    if is_scan(prediction.voxels.shown_at_once, prediction.ends_in_plane):
        return settings.occupancy_threshold_low
    if prediction.voxels.shown_at_once < settings.shown_of_piece:
        return settings.occupancy_threshold_piece
    share = _missing_share(prediction)
    levels = (settings.occupancy_threshold_high, settings.occupancy_threshold_low)
    by_share = float(np.interp(share, settings.threshold_missing_shares, levels))
    if not is_mirrored(prediction):
        return by_share
    return max(
        by_share,
        float(np.interp(prediction.symmetry_score, _SYMMETRY_SCORES, levels)),
    )


def is_mirrored(prediction: Prediction) -> bool:
    """Say whether the network was given any mirror image."""
    return prediction.inputs.symmetries[0].score > 0


def mirror_plane_of(symmetry: SymmetryMap) -> MirrorPlane:
    """Return a mirror image's plane as users write it, to the digits that they see."""
    angle, offset = plane_of(symmetry)
    return MirrorPlane(round(math.degrees(angle), 1), round(offset, 3))


def image_of_half(
    partial: Splats,
    plane: MirrorPlane,
    views: ViewDistribution,
    generator: torch.Generator,
) -> Splats:
    """Return P's mirror image, without splats that would hide P in V's views or that P has already.

    Args:
        partial: one half of an object, in the object frame.
        plane: the plane that it was cut along.
        views: V.
        generator: chooses the splats of P that copies are compared with, if there are too many.
    """
    symmetry = mirror(math.radians(plane.azimuth_deg), plane.offset, 1.0)
    copies = mirror_image(partial, symmetry)
    copies = copies.select(hides_nothing(copies, gather_evidence(partial, views)))
    return beyond(copies, partial, generator, solid_views(partial))


def beyond(
    copies: Splats, partial: Splats, generator: torch.Generator, solid: SolidViews | None = None
) -> Splats:
    """Return the copies that lie where P has no surface, as close to its rim as the seam allows."""
    if not len(copies):
        return copies
    normals = thinnest_axes(copies.quaternions, copies.scales)
    anchor = thinned(partial, _MOST_LOOKED_AT, generator)
    seam = _SEAM_SPACINGS * median_spacing(anchor.means)
    beyond = SurfaceSettings(near_rim=min(_MOST_SEAM, seam), one_sided=_ONE_SIDED_COPY)
    copies = copies.select(is_missing(copies.means, normals, anchor.means, beyond))
    return copies if solid is None else copies.select(~solid.cover(copies.means))


def select_consistent(
    copies: Splats,
    occupancy: Tensor,  # [1, C, C, C] logits of the network's answer
    evidence: Evidence,
    least_logit: float = _LEAST_COPY_LOGIT,
) -> Splats:
    """Return the copies that neither the network nor the views contradict."""
    logit = sample_volume(occupancy, copies.means)[:, 0]
    return copies.select((logit > least_logit) & hides_nothing(copies, evidence))


def contradicted_by(
    known: Sequence[FittedShape],
    copies: Splats,
    doubted: Tensor,  # [N] bool by the network
) -> Tensor:  # [N] bool
    """Mark the copies that known shapes contradict, such as a mug's second handle.

    Doubted copies far from all known shapes come first. Near them, doubted copies that are only a
    little off the known shapes are marked too, and copies whose colour is nearer to that of the
    marked ones than to that of the others: these are the ends of the handle.
    """
    if len(known) < _FEWEST_KNOWN or not bool(doubted.any()):
        return torch.zeros_like(doubted)
    points = copies.means.numpy()
    away = np.min([cKDTree(shape.points).query(points)[0] for shape in known], axis=0)
    far = doubted.numpy() & (away > _UNLIKE_KNOWN)
    if not far.any():
        return torch.zeros_like(doubted)
    beside, _ = cKDTree(points[far]).query(points, distance_upper_bound=_BESIDE)
    is_beside = torch.from_numpy(np.isfinite(beside))
    marked = torch.from_numpy(far | (doubted.numpy() & (away > _OFF_KNOWN))) & is_beside
    theirs, others = (
        copies.base_colors[side].median(dim=0).values if bool(side.any()) else None
        for side in (marked, is_beside & ~marked)
    )
    if theirs is None or others is None or float((theirs - others).norm()) < _OTHER_COLOR:
        return marked
    to_theirs, to_others = ((copies.base_colors - color).norm(dim=1) for color in (theirs, others))
    return marked | (is_beside & (to_theirs < to_others))


def stands_off(known: Sequence[FittedShape], splats: Splats, contradicted: Splats) -> Tensor:
    """Mark the splats near contradicted copies that are off all known shapes: stumps of a handle.

    Args:
        known: shapes, at least one.
        splats: N of the network's surface.
        contradicted: copies that ``contradicted_by`` marked, at least one.

    Returns:
        [N] bool.
    """
    points = splats.means.numpy()
    beside, _ = cKDTree(contradicted.means.numpy()).query(points, distance_upper_bound=_BESIDE)
    away = np.min([cKDTree(shape.points).query(points)[0] for shape in known], axis=0)
    return torch.from_numpy(np.isfinite(beside) & (away > _OFF_KNOWN))


def in_holes(splats: Splats, voxels: PartialVoxels) -> Tensor:  # [N] bool
    """Mark the splats where views near c see through P's holes, if P has many."""
    points, toward_c = voxels.positions, voxels.evidence.toward_c()
    return torch.from_numpy(seen_through(points, toward_c, splats.means.numpy()))


def hides_nothing(splats: Splats, evidence: Evidence) -> Tensor:  # [N] bool
    """Mark the splats that most views do not see in front of P."""
    in_front = torch.from_numpy(evidence.classify(splats.means.numpy())[:, 0])
    return in_front <= _MOST_IN_FRONT
