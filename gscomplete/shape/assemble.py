"""The guess of the complete object: P mirrored where consistent, the network's surface elsewhere.

Conventions
-----------
* Lengths are in object sizes. "New" is what P does not have.
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
from gscomplete.shape.outline.one_view import ONE_VIEW_SHARE
from gscomplete.shape.predict import Prediction
from gscomplete.shape.surface import (
    SurfaceSettings,
    is_missing,
    median_spacing,
    surface_splats,
)
from gscomplete.shape.symmetry import SymmetryMap, mirror, mirror_image, plane_of
from gscomplete.shape.voxels import CELL_SIDE, grown, sample_volume, surface_cells
from gscomplete.splats import Splats, concatenate
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.splats.thinning import thinned
from gscomplete.views import ViewDistribution

_LEAST_SPACING = 0.002
_MOST_SPACING = 0.03
"""Of the surface beside mirrored splats, which is that of the mirrored splats between the two."""
_MOST_LOOKED_AT = 20_000
"""Splats of P that tell where P is."""
_SEAM_SPACINGS, _ONE_SIDED_COPY = 0.5, 0.55
"""Copies beyond P's rim count as new from so many of P's spacings on, where P's nearest splats lie
to one side by so much: else a dark line is left along a cut."""
_LEAST_COPY_LOGIT = -2.0
"""Copies in cells that the network finds emptier than this are left out, unless the plane is
certain: of half a cow it takes the other side's legs for cut off, as P's views show none, ..."""
_DOUBTED_LOGIT, _FEWEST_KNOWN, _UNLIKE_KNOWN = 0.0, 2, 0.08
"""Copies in cells emptier than this are left out, too, where so many known shapes suit P and none
is this near, object sizes; ..."""
_FEW_DOUBTED = 0.02
"""Known shapes are not looked for where no more of the copies are doubted."""
_BESIDE, _OFF_KNOWN = 0.12, 0.03
"""... within the first of these such that none is nearer than the second ..."""
_OTHER_COLOR = 0.2
"""... and those of their colour, where it is so far from that of the others there (sRGB); ..."""
_MOST_IN_FRONT = 0.5
"""... and those that more than this share of the views sees to be in front of P."""
_LEAST_SYMMETRY_SCORE = 0.75
"""Score of the first mirror image, by the network's output, from which on its splats are used;
below it the network's surface is all there is."""
_LITTLE = 0.1
"""Where P lacks less of the network's surface, mirrored splats would only stand beside P's own: of
parts of 60 unseen objects, complete ones alone are below .12."""
_LOGIT_BESIDE = 0.0
"""Cells of the network's surface beside mirrored splats count as filled from this logit on."""
_SYMMETRY_SCORES = (0.1, 0.3)
"""Little is missing where no mirror image of P scores more than the first: none adds anything
that the network predicts. From the second on that says nothing."""
_GAP_SPACINGS = 3.0
"""Where P and mirrored splats leave gaps wider than so many spacings of splats, the network's
surface closes them."""
_NEARLY_ALL = 0.9
"""Share of P's splats whose mirror image is all that is added; where fewer are left, they would
have hidden P."""
_NEXT_TO_NOTHING = 0.02
"""Share of the filled cells below which what the prompt changes is not to be seen."""


@dataclass(frozen=True, slots=True)
class AssembleSettings:
    """How the first guess is put together."""

    count: int = 20_000
    """Most splats of the network's surface. Mirrored ones are as many as P has: between fewer,
    however wide, what lies behind them shows."""
    occupancy_threshold_low: float = -1.0
    """Without mirrored splats: from this logit on where much is missing (of what one view shows, a
    whole side); the network is never confident of thin walls there, and some excess is accepted
    for them ..."""
    occupancy_threshold_high: float = 0.25
    """... and from this one on where little is missing, so that what is complete stays as it is. On
    135 parts of 15 real objects that no benchmark uses, IoU is .009 above that of -1 everywhere:
    .023 on those that lack little, .001 on the others."""
    occupancy_threshold_piece: float = -0.5
    """From this one on where P is a piece, cut off by a box or a plane, however much is missing:
    what scanners or cameras saw shows more of itself at once. On 48 such parts of 29 validation
    objects outside the 48, on which it was chosen, IoU is .009 above that of the other two."""
    shown_of_piece: float = 0.8
    """P is a piece where no view shows more of it at once."""
    threshold_missing_shares: tuple[float, float] = (0.2, 0.3)
    """Little is missing, too, where no more of the surface than the first share lies beyond P's
    cells and those beside them (were more counted as P's, scattered splats would pass for a
    surface); from the second on that says nothing. Between them levels are interpolated; the
    higher one counts."""
    near_partial: float = 0.03
    """Without mirrored splats: surface this near to P's splats is P's own, as
    ``SurfaceSettings.near_partial`` says."""
    image_is_all: bool = False
    """Nothing of the network's surface counts beside P's own splats, mirrored, where nearly all of
    them do: what P lacks was cut away along the plane."""
    reach: float = 1.5 * CELL_SIDE
    """Surface this near to P's splats or mirrored ones is theirs; cells blur it by as much."""


@dataclass(frozen=True, slots=True)
class AssembledSplats:
    """What completes one object."""

    splats: Splats
    """The new splats."""
    mirrored: int
    """How many of them, the first, are P's own, mirrored."""
    contradicted: int = 0
    """How many mirrored ones known shapes contradict."""


def assemble_splats(
    prediction: Prediction,
    partial: Splats,
    settings: AssembleSettings,
    generator: torch.Generator,
    known: Callable[[], Sequence[FittedShape]] = tuple,
) -> AssembledSplats:
    """Return the new splats of one object.

    Args:
        prediction: the network's answer and what it was given.
        partial: P in the object frame.
        settings: knobs.
        generator: chooses where splats sit.
        known: finds shapes that suit P, which may contradict mirror images; called where the
            network doubts a part of them.
    """
    copies, contradicted = mirrored_copies(prediction, partial, generator, known)
    covering = surface_settings(prediction, settings, copies)
    asked = prediction.output, prediction.seen, partial, covering, generator
    if copies is None:
        return AssembledSplats(surface_splats(*asked), 0)
    if settings.image_is_all and len(copies) >= _NEARLY_ALL * len(partial):
        return AssembledSplats(copies, len(copies), len(contradicted))
    surface = surface_splats(*asked, copies)
    if len(contradicted):
        surface = surface.select(~stands_off(known(), surface, contradicted))
    return AssembledSplats(concatenate([copies, surface]), len(copies), len(contradicted))


def mirrored_copies(
    prediction: Prediction,
    partial: Splats,
    generator: torch.Generator,
    known: Callable[[], Sequence[FittedShape]] = tuple,
) -> tuple[Splats | None, Splats]:
    """Return P's splats through the first mirror image, where P has none and nothing is against.

    The second value are those that known shapes alone are against. None = P's own splats are not
    to be mirrored, or none of them is left. Arguments are those of :func:`assemble_splats`.
    """
    if not is_mirrored_by_splats(prediction):
        return None, partial.select(torch.arange(0))
    copies = mirror_image(partial, prediction.seen.symmetries[0])
    occupancy = prediction.output.occupancy.float()
    least_logit = -math.inf if _is_certain(prediction) else _LEAST_COPY_LOGIT
    copies = select_consistent(copies, occupancy, prediction.voxels.evidence, least_logit)
    doubted = sample_volume(occupancy, copies.means)[:, 0] < _DOUBTED_LOGIT
    against = torch.zeros_like(doubted)
    if float(doubted.sum()) > _FEW_DOUBTED * len(copies):
        against = contradicted_by(known(), copies, doubted)
    contradicted, copies = copies.select(against), copies.select(~against)
    copies = _beyond(copies, partial, generator)
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
    return SurfaceSettings(
        settings.count,
        near_partial=settings.reach,
        gap_spacings=_GAP_SPACINGS,
        filled_logit=_LOGIT_BESIDE,
        least_spacing=min(max(median_spacing(copies.means), _LEAST_SPACING), _MOST_SPACING),
    )


def is_mirrored_by_splats(prediction: Prediction) -> bool:
    """Say whether the plane of symmetry is sure enough for P's own splats to be mirrored."""
    is_sure = prediction.symmetry_score >= _LEAST_SYMMETRY_SCORE
    return is_sure and _missing_share(prediction) >= _LITTLE


def _is_certain(prediction: Prediction) -> bool:
    """Say whether the plane is taken without a doubt: users and square cuts are."""
    return prediction.symmetry_score >= 1.0


def _missing_share(prediction: Prediction) -> float:  # in [0, 1]
    """Return how much of the network's surface P does not have."""
    surface = surface_cells(prediction.output.occupancy > 0)
    away = surface & (grown(torch.from_numpy(prediction.voxels.volume[:1])) <= 0)
    return float(away.sum()) / max(float(surface.sum()), 1.0)


def _surface_logit(prediction: Prediction, settings: AssembleSettings) -> float:
    """Return the logit from which on cells count as filled, by how P was cut and what it lacks."""
    if _is_scan(prediction):
        return settings.occupancy_threshold_low
    if prediction.voxels.shown_at_once < settings.shown_of_piece:
        return settings.occupancy_threshold_piece
    share = _missing_share(prediction)
    levels = (settings.occupancy_threshold_high, settings.occupancy_threshold_low)
    by_share = float(np.interp(share, settings.threshold_missing_shares, levels))
    if not _is_mirrored(prediction):
        return by_share
    return max(
        by_share,
        float(np.interp(prediction.symmetry_score, _SYMMETRY_SCORES, levels)),
    )


def _is_scan(prediction: Prediction) -> bool:
    """Say whether P is what one view shows: a whole side is missing, however little it seems."""
    return not prediction.ends_in_plane and prediction.voxels.shown_at_once >= ONE_VIEW_SHARE


def _is_mirrored(prediction: Prediction) -> bool:
    """Say whether the network was given any mirror image."""
    return prediction.seen.symmetries[0].score > 0


def mirror_plane_of(symmetry: SymmetryMap) -> MirrorPlane:
    """Return a mirror image's plane as users write it, to the digits that they see."""
    angle, offset = plane_of(symmetry)
    return MirrorPlane(round(math.degrees(angle), 1), round(offset, 3))


def notes_of(prediction: Prediction, mirrored: int) -> tuple[str, ...]:
    """Tell users what decided the guess: their prompt, and the plane that P was mirrored through.

    Args:
        prediction: what the network was given, and its answer.
        mirrored: how many of the new splats are P's own.
    """
    prompt = _prompt_note(prediction.prompt_share)
    return (*prompt, _mirror_note(prediction, mirrored))


def _prompt_note(share: float | None) -> tuple[str, ...]:
    if share is None:
        return ()
    if share < _NEXT_TO_NOTHING:
        decides = "P decides it (--prompt-decides: the prompt does)"
        return (f"prompt: changes next to nothing of the shape ({share:.1%}): {decides}",)
    return (f"prompt: changes {share:.0%} of the guessed shape",)


def _mirror_note(prediction: Prediction, mirrored: int) -> str:
    """Name the plane as users would ask for it."""
    if not _is_mirrored(prediction):
        return "not mirrored"
    plane = mirror_plane_of(prediction.seen.symmetries[0])
    how = "by P's own splats" if mirrored else "as a hint"
    return f"mirrored {how} through the upright plane {plane} (--mirror)"


def image_of_half(
    partial: Splats,
    plane: MirrorPlane,
    views: ViewDistribution,
    generator: torch.Generator,
) -> Splats:
    """Return P's image through a plane, without what V's views do not allow or P has.

    Args:
        partial: one half of an object, in the object frame.
        plane: that it was cut along.
        views: V.
        generator: chooses the splats of P that tell where P is.
    """
    symmetry = mirror(math.radians(plane.azimuth_deg), plane.offset, 1.0)
    copies = mirror_image(partial, symmetry)
    copies = copies.select(hides_nothing(copies, gather_evidence(partial, views)))
    return _beyond(copies, partial, generator)


def _beyond(copies: Splats, partial: Splats, generator: torch.Generator) -> Splats:
    """Return the mirrored splats that lie where P has none, up to its rim."""
    if not len(copies):
        return copies
    axes = rotation_matrices(copies.quaternions)
    thinnest = copies.scales.argmin(dim=1)[:, None, None].expand(-1, 3, 1)
    normals = axes.gather(2, thinnest)[:, :, 0]
    anchor = thinned(partial, _MOST_LOOKED_AT, generator)
    seam = _SEAM_SPACINGS * median_spacing(anchor.means)
    beyond = SurfaceSettings(
        near_rim=min(SurfaceSettings().near_rim, seam), one_sided=_ONE_SIDED_COPY
    )
    return copies.select(is_missing(copies.means, normals, anchor.means, beyond))


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
    """Mark the copies that the network doubts and no known shape has: a mug's second handle.

    Beside those what stands off them at all is marked, too, and what is of their colour rather than
    of the others': the handle's ends.
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
    """Mark the splats beside contradicted copies that no known shape has: a second handle's stumps.

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


def hides_nothing(splats: Splats, evidence: Evidence) -> Tensor:  # [N] bool
    """Mark the splats that most views do not see in front of P."""
    in_front = torch.from_numpy(evidence.classify(splats.means.numpy())[:, 0])
    return in_front <= _MOST_IN_FRONT
