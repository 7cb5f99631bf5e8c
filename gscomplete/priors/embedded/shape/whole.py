"""The first guess of the whole: P mirrored where that is believed, the network's surface elsewhere.

Conventions
-----------
* Lengths are in object sizes. "New" is what P does not have.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.priors.base import MirrorPlane
from gscomplete.priors.embedded.shape.grid import CELL_SIDE, CELLS, HALF_SIDE, cells_away
from gscomplete.priors.embedded.shape.mirrored import borne_out, mirror_image
from gscomplete.priors.embedded.shape.model import ShapeOutput
from gscomplete.priors.embedded.shape.predict import Prediction
from gscomplete.priors.embedded.shape.surface import (
    SurfaceSettings,
    is_missing,
    median_spacing,
    surface_splats,
)
from gscomplete.priors.embedded.shape.symmetries import SymmetryMap, plane_of
from gscomplete.splats import Splats, concatenate
from gscomplete.splats.filters import thinned
from gscomplete.splats.rotations import rotation_matrices

_LEAST_SPACING = 0.002
_MOST_SPACING = 0.03
"""Of the surface beside mirrored splats, which is that of the mirrored splats between the two."""
_MOST_MIRRORED = 60_000
"""Splats of P, chosen at random where it has more."""
_MOST_LOOKED_AT = 20_000
"""Splats of P that tell where P is."""


@dataclass(frozen=True, slots=True)
class WholeSettings:
    """How the first guess is put together."""

    count: int = 20_000
    """Most new splats."""
    least_worth: float = 0.75
    """Worth of the first mirror image, by the network's answer, from which on its splats are used;
    below it the network's surface is all there is."""
    mirrored_share: float = 0.7
    """Most of the new splats that are mirrored ones."""
    led_penalty: float = 1.5
    """Beside a mirror image that is believed, cells of the network's own need logits higher by this
    to count as filled: what it is less sure of is more often wrong than right there ..."""
    penalty_cells: tuple[float, float] = (3.0, 5.0)
    """... from nothing at the first distance from P and from its mirrored splats, whichever is
    farther, to all of it at the second: so that the gap between them is closed."""
    gap_spacings: float = 3.0
    """Where P and mirrored splats leave gaps wider than so many spacings of splats, the network's
    surface closes them."""
    reach: float = 1.5 * CELL_SIDE
    """Surface this near to P's splats or mirrored ones is theirs; cells blur it by as much."""


def whole_splats(
    prediction: Prediction, partial: Splats, settings: WholeSettings, generator: torch.Generator
) -> Splats:
    """Return the new splats of one object.

    Args:
        prediction: the network's answer and what it was shown.
        partial: P in the object frame.
        settings: knobs.
        generator: chooses where splats sit.
    """
    copies = None
    most = int(settings.mirrored_share * settings.count)
    if most and prediction.worth >= settings.least_worth:
        copies = _new_copies(prediction, partial, most, generator)
    if copies is None or not len(copies):
        plain = SurfaceSettings(settings.count)
        return surface_splats(prediction.output, prediction.seen, partial, plain, generator)
    output = _less_sure(prediction.output, partial, copies, settings)
    beside = SurfaceSettings(
        settings.count - len(copies),
        near_partial=settings.reach,
        gap_spacings=settings.gap_spacings,
        least_spacing=min(max(median_spacing(copies.means), _LEAST_SPACING), _MOST_SPACING),
    )
    surface = surface_splats(output, prediction.seen, partial, beside, generator, copies)
    return concatenate([copies, surface])


def _less_sure(
    output: ShapeOutput, partial: Splats, copies: Splats, settings: WholeSettings
) -> ShapeOutput:
    """Lower the logits of cells but for those between P and mirrored splats."""
    away = torch.maximum(_cells_to(partial.means), _cells_to(copies.means))
    low, high = settings.penalty_cells
    share = ((away - low) / (high - low)).clamp(0, 1)
    return dataclasses.replace(output, occupancy=output.occupancy - settings.led_penalty * share)


def _cells_to(points: Tensor) -> Tensor:  # [N, 3] -> [C, C, C]
    """Return every cell's distance to the nearest cell with a point, in cells."""
    cells = ((points + HALF_SIDE) / CELL_SIDE).floor().long()
    inside = cells[((cells >= 0) & (cells < CELLS)).all(dim=1)]
    filled = torch.zeros(CELLS, CELLS, CELLS, dtype=torch.bool)
    filled[tuple(inside.T)] = True
    return torch.from_numpy(cells_away(filled.numpy()))


def mirror_plane_of(symmetry: SymmetryMap) -> MirrorPlane:
    """Return a mirror image's plane as users write it, to the digits that they see."""
    angle, offset = plane_of(symmetry)
    return MirrorPlane(round(math.degrees(angle), 1), round(offset, 3))


def mirror_note(prediction: Prediction, settings: WholeSettings) -> str:
    """Tell users through which plane P was mirrored, as they would ask for it."""
    first = prediction.seen.symmetries[0]
    if first.score == 0:
        return "not mirrored"
    plane = mirror_plane_of(first)
    how = "by P's own splats" if prediction.worth >= settings.least_worth else "as a hint"
    return f"mirrored {how} through the upright plane {plane} (--mirror)"


def _new_copies(
    prediction: Prediction, partial: Splats, limit: int, generator: torch.Generator
) -> Splats:
    """Return P's splats through the first mirror image, where P has none and nothing is against."""
    source = thinned(partial, _MOST_MIRRORED, generator)
    copies = mirror_image(source, prediction.seen.symmetries[0])
    copies = borne_out(copies, prediction.output.occupancy.float(), prediction.look.evidence)
    if not len(copies):
        return copies
    axes = rotation_matrices(copies.quaternions)
    thinnest = copies.scales.argmin(dim=1)[:, None, None].expand(-1, 3, 1)
    normals = axes.gather(2, thinnest)[:, :, 0]
    anchor = thinned(partial, _MOST_LOOKED_AT, generator)
    is_new = is_missing(copies.means, normals, anchor.means, SurfaceSettings())
    return thinned(copies.select(is_new), limit, generator)
