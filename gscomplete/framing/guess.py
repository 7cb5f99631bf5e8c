"""Guess where the complete object is, from a part of it: centre, size and input view.

The paper's authors set these by hand (its "Limitations" expects heuristics to do it). The box of P
is not the box of the complete object: half a mug has its true centre on the cut. Every guess can be
overridden, and the reasons are recorded with the run.

Conventions
-----------
* Splats come in z-up axes at the file's scale (``views.up_rotation`` applied); azimuth and
  elevation as in ``views``.
* A splat's outward normal is its thinnest axis, signed to point away from the centroid of P; for
  round splats it is the direction away from the centroid itself. Where that normal faces the
  camera P shows its outside, elsewhere its inside.
* ``facing`` of a view is the share of its visible area that shows P's outside; ``visible`` is the
  share of P's splats that lie on the surface seen.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.framing.cut_plane import find_cut
from gscomplete.framing.end_plane import find_end
from gscomplete.framing.extent import extended_box, is_closed
from gscomplete.render import render
from gscomplete.splats import Splats, colors_to_sh
from gscomplete.splats.geometry.n_fold import find_n_fold
from gscomplete.splats.geometry.neighbourhood import are_flat, flat_axes
from gscomplete.splats.geometry.revolution import box_of, find_revolution
from gscomplete.splats.geometry.upright_plane import UprightPlane
from gscomplete.splats.rotations import thinnest_axes
from gscomplete.util.arrays import Float64Array
from gscomplete.util.same_bits import fixed_sum
from gscomplete.views import Cameras, orbit_cameras
from gscomplete.views.distribution import FOV_DEG, RADIUS

_SURFACE_TOLERANCE = 0.03
"""A splat this far behind the surface seen still counts as visible (in sides of P's box)."""
_FLOATER_DENSITY = 0.03
"""A splat with less than this share of the median density around it is a floater."""
_DENSE_NEIGHBOURS = 8.0
"""With at least this many splats around the median one, a splat all alone is a floater."""
_MAX_FLOATER_FRACTION = 0.02
"""If more than this share of the splats counts as floaters, all are taken as object."""
_MIN_OPENNESS = 0.25
"""How one-sided the view scores must be for P to count as open, in [0, 1]."""


@dataclass(frozen=True, slots=True)
class FramingSettings:
    """Knobs of the guess; the defaults were chosen on cuts of 38 real meshes."""

    azimuths: int = 24
    """Azimuths tried, evenly round the object; even, so that every view has an opposite."""
    elevations_deg: tuple[float, ...] = (0.0, 15.0, 30.0)
    """Elevations tried for the input view."""
    size_px: int = 64
    """Side of the renders that views are judged by."""
    max_splats: int = 20_000
    """Splats drawn for that; of larger objects, an even choice with widths grown to match."""


@dataclass(frozen=True, slots=True)
class FramingGuess:
    """Where the complete object is estimated to be."""

    center: tuple[float, float, float]
    """Centre of the complete object, in the z-up axes of the splats given."""
    size: float
    """Largest side of the complete object, in the units of the splats given."""
    view_azimuth_deg: float
    """Azimuth of the input view c."""
    view_elevation_deg: float
    """Elevation of the input view c."""
    notes: tuple[str, ...]
    """What was noticed, for the user."""
    view_reason: str
    """Why that view."""
    box_reason: str
    """Why that centre and size."""


@dataclass(frozen=True, slots=True)
class ViewScores:
    """P's appearance from E elevations times A azimuths."""

    azimuths_deg: Float64Array  # [A]
    elevations_deg: Float64Array  # [E]
    area: Float64Array  # [E, A] visible alpha as a share of the image
    facing: Float64Array  # [E, A] share of that area which shows P's outside
    visible: Float64Array  # [E, A] share of P's splats on the surface seen

    @property
    def score(self) -> Float64Array:  # [E, A]
        """How good an input view is: it shows much of P, from outside, and its opposite does not.

        On 152 cuts of real meshes this lay within 45 degrees of the side that was kept or scanned
        in 88 % of the cases; area alone in 62 %, because a silhouette and its opposite are alike.
        """
        opposite = np.roll(self.facing, len(self.azimuths_deg) // 2, axis=1)
        return self.visible * self.area * (1.5 + self.facing - opposite)

    def openness(self) -> tuple[float, float]:
        """Return the azimuth towards which P is open, and in [0, 1] how one-sided it is.

        The direction is the first circular moment of the low views' scores, reversed: good views
        are opposite to what is missing.
        """
        low = self.score[np.abs(self.elevations_deg) < 20.0].mean(axis=0)
        angles = np.deg2rad(self.azimuths_deg)
        moment = np.array([(low * np.cos(angles)).sum(), (low * np.sin(angles)).sum()])
        strength = 2.0 * float(np.hypot(*moment)) / max(float(low.sum()), 1e-12)
        return math.degrees(math.atan2(-moment[1], -moment[0])) % 360.0, min(strength, 1.0)


def guess_framing(
    partial: Splats,
    settings: FramingSettings | None = None,
    *,
    seen_from_deg: float | None = None,
    is_half: bool = False,
    half_toward_deg: float | None = None,
) -> FramingGuess:
    """Guess centre, size and input view of the complete object.

    Floaters are left out of P's box. The input view is the candidate with the best
    ``ViewScores.score``. If P is part of a surface of revolution, the box is that of all of it
    (``revolution.box_of``). If P is open towards a side, the box grows that way (``extended_box``);
    it never grows vertically, because scans lack the side that an object stands on, nor where P's
    surface is closed (``extent``).

    Args:
        partial: P in z-up axes.
        settings: knobs; None = defaults.
        seen_from_deg: azimuth that all of P was seen from, if a single scanner recorded it. If P
            is open, it is so towards the opposite side, whatever the scores say. None = unknown.
        is_half: whether what is missing is P's mirror image through the plane that P ends at.
        half_toward_deg: rough azimuth of the other half; None = it is found.

    Raises:
        UserError: P has no finite splat, or all are at one place.
    """
    chosen = settings or FramingSettings()
    kept, notes = object_splats(partial)
    low, high = (corner.double().numpy() for corner in kept.bounds())
    size = float((high - low).max())
    if not size > 0:
        raise UserError(
            "framing: all splats are at one place; give --center, --object-size and --view"
        )
    scores = score_views(_centered(kept, (low + high) / 2, size), chosen)
    row, column = np.unravel_index(int(np.argmax(scores.score)), scores.score.shape)
    azimuth, elevation = float(scores.azimuths_deg[column]), float(scores.elevations_deg[row])
    view_reason = (
        f"input view {azimuth:g},{elevation:g}: {100 * scores.visible[row, column]:.0f} % of the "
        f"splats visible, {100 * scores.facing[row, column]:.0f} % of the area is outside surface"
    )
    toward, strength = scores.openness()
    points = kept.means.double().numpy()
    axes = flat_axes(kept)
    cut = find_cut(points, axes)
    mirror = cut if cut is not None and cut.is_symmetric and seen_from_deg is None else None
    through = None if mirror is None else (math.radians(mirror.azimuth_deg), mirror.offset)
    if seen_from_deg is not None:
        toward = (seen_from_deg + 180.0) % 360.0
    end = find_end(points, cut, half_toward_deg, axes) if is_half else None
    if end is not None:
        center, size = _box_of_both(points, end)
        reason = "P is one half: centre and size are those of P with its mirror image"
    elif is_closed(points, cut, lambda: strength):
        center, reason = (
            (low + high) / 2,
            "P's surface is closed: centre and size are those of its box",
        )
    elif (revolution := find_revolution(points, axes, through)) is not None:
        center, size = box_of(revolution, points)
        reason = (
            "P is part of a surface of revolution: centre and size are those of the whole of it"
        )
    elif (fold := find_n_fold(points, axes, through)) is not None:
        center, size = fold.box(points)
        reason = (
            f"P is symmetric by turns of 1/{fold.folds} about an upright axis: centre and size are "
            "those of the whole of it"
        )
    elif mirror is not None:
        center, size = _box_of_both(points, mirror)
        reason = "P ends squarely at a plane: centre and size are those of P with its mirror image"
    elif strength < _MIN_OPENNESS:
        center, reason = (
            (low + high) / 2,
            "no side is clearly open: centre and size are those of P's box",
        )
    else:
        center, grown, reason = extended_box(points, toward)
        size = max(size, grown)
    box_reason = f"{reason} (openness {strength:.2f} towards azimuth {toward:.0f})"
    x, y, z = center.tolist()
    return FramingGuess((x, y, z), size, azimuth, elevation, tuple(notes), view_reason, box_reason)


def _box_of_both(
    points: Float64Array,  # [N, 3]
    plane: UprightPlane,
) -> tuple[Float64Array, float]:  # [3]
    """Return the centre and the largest side of the box of points and their mirror image."""
    both = np.concatenate([points, plane.mirrored(points)])
    low, high = both.min(axis=0), both.max(axis=0)
    return (low + high) / 2, float((high - low).max())


def score_partial(partial: Splats, settings: FramingSettings | None = None) -> ViewScores:
    """Score the candidate views of P, in z-up axes, without its floaters.

    Raises:
        UserError: P has no finite splat.
    """
    chosen = settings or FramingSettings()
    kept, _ = object_splats(partial)
    low, high = (corner.double().numpy() for corner in kept.bounds())
    return score_views(_centered(kept, (low + high) / 2, float((high - low).max())), chosen)


def object_splats(partial: Splats) -> tuple[Splats, list[str]]:
    """Return the finite splats of P without floaters, and what was left out.

    A floater has next to no other splats in the 27 grid cells around it (cells of 1/24 of the box
    of the middle 98 % of P), compared with the median splat.

    Raises:
        UserError: no splat has a finite position.
    """
    finite = torch.isfinite(partial.means).all(dim=1) & (partial.opacities > 0.02)
    if not bool(finite.any()):
        finite = torch.isfinite(partial.means).all(dim=1)
    if not bool(finite.any()):
        raise UserError("framing: no splat has a finite position")
    kept = partial.select(finite)
    reasons = []
    if len(kept) < len(partial):
        reasons.append(f"{len(partial) - len(kept)} invisible or non-finite splats ignored")
    density = _local_density(kept.means.double().numpy())
    median = float(np.median(density))
    is_dense = median >= _DENSE_NEIGHBOURS
    floating = density < max(_FLOATER_DENSITY * median, 2.0 if is_dense else 0.0)
    count = int(floating.sum())
    if 0 < count <= _MAX_FLOATER_FRACTION * len(kept):
        reasons.append(f"{count} floating splats ignored")
        kept = kept.select(torch.from_numpy(~floating))
    return kept, reasons


def score_views(centered: Splats, settings: FramingSettings) -> ViewScores:
    """Render P from every candidate view and score the views.

    Args:
        centered: P with its box centred at the origin and of largest side 1.
        settings: knobs.
    """
    drawn = _thinned(centered, settings.max_splats)
    normals = normals_from_centroid(drawn)
    drawn = dataclasses.replace(drawn, sh=colors_to_sh(0.5 + 0.5 * normals))
    azimuths = 360.0 / settings.azimuths * torch.arange(settings.azimuths, dtype=torch.float64)
    rows = []
    for elevation in settings.elevations_deg:
        cameras = orbit_cameras(
            azimuths,
            torch.full_like(azimuths, elevation),
            radius=RADIUS,
            fov_deg=FOV_DEG,
            size_px=settings.size_px,
        )
        rows.append(_score_ring(drawn, cameras, _SURFACE_TOLERANCE))
    area, facing, visible = (np.stack(column) for column in zip(*rows, strict=True))
    elevations = np.array(settings.elevations_deg)
    return ViewScores(azimuths.numpy(), elevations, area, facing, visible)


def normals_from_centroid(splats: Splats) -> Tensor:  # [N, 3] unit
    """Return each splat's normal, signed to point away from the opacity-weighted centroid."""
    weights = splats.opacities[:, None]
    centroid = (weights * splats.means).sum(dim=0) / fixed_sum(weights).clamp_min(1e-12)
    outward = torch.nn.functional.normalize(splats.means - centroid, dim=1)
    unit = torch.nn.functional.normalize(splats.quaternions, dim=1)
    normals = thinnest_axes(unit, splats.scales)
    sign = torch.where((normals * outward).sum(dim=1, keepdim=True) < 0, -1.0, 1.0)
    return torch.where(are_flat(splats)[:, None], sign * normals, outward)


def _score_ring(
    splats: Splats,  # colours hold outward normals as 0.5 + 0.5 n
    cameras: Cameras,
    tolerance: float,
) -> tuple[Float64Array, Float64Array, Float64Array]:  # area, facing, visible, each [A]
    """Score one ring of views."""
    with torch.no_grad():
        seen = render(splats, cameras)
    normals = 2.0 * seen.color / seen.alpha.clamp_min(1e-3)[..., None] - 1.0
    backward = -cameras.camera_from_world[:, 2, :3]  # from the scene to the camera
    outside = (torch.einsum("vhwc,vc->vhw", normals, backward) > 0) * seen.alpha
    total = seen.alpha.sum(dim=(1, 2)).clamp_min(1e-6)
    facing = outside.sum(dim=(1, 2)) / total
    area = seen.alpha.mean(dim=(1, 2))
    visible = []
    for matrix, focal, depth in zip(
        cameras.camera_from_world, cameras.focal_px, seen.depth, strict=True
    ):
        points = splats.means @ matrix[:3, :3].T + matrix[:3, 3]
        pixels = points[:, :2] / points[:, 2:] * focal + cameras.width / 2
        column, row = pixels.long().clamp(0, cameras.width - 1).unbind(1)
        visible.append((points[:, 2] < depth[row, column] + tolerance).float().mean())
    values = (area, facing, torch.stack(visible))
    return tuple(value.double().numpy() for value in values)  # type: ignore[return-value]


def _centered(splats: Splats, center: Float64Array, size: float) -> Splats:
    """Return the splats, float32 on the CPU, moved to the origin and scaled to size 1."""
    means = (splats.means.double().cpu() - torch.from_numpy(center)) / size
    scales = (splats.scales.double().cpu() / size).float()
    return dataclasses.replace(
        splats.to("cpu", torch.float32), means=means.float(), scales=scales
    ).detach()


def _thinned(splats: Splats, max_splats: int) -> Splats:
    """Return an even choice of at most ``max_splats`` splats that covers the same surface."""
    step = math.ceil(len(splats) / max_splats)
    if step <= 1:
        return splats
    chosen = splats.select(torch.arange(0, len(splats), step))
    return dataclasses.replace(chosen, scales=chosen.scales * math.sqrt(step))


def _local_density(points: Float64Array) -> Float64Array:  # [N, 3] -> [N]
    """Count the points in the 27 grid cells around each point."""
    low, high = np.quantile(points, [0.01, 0.99], axis=0)
    side = float((high - low).max()) / 24.0
    if not side > 0:
        return np.ones(len(points))
    # A floater may be astronomically far away: positions are clipped before they become integers.
    positions = np.floor((points - low) / side)
    cells = np.clip(positions, -1000, 1000).astype(np.int64) + 1001
    strides = np.array([2003 * 2003, 2003, 1])
    keys, inverse, counts = np.unique(cells @ strides, return_inverse=True, return_counts=True)
    shifts = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    around = np.zeros(len(keys))
    for shift in shifts @ strides:
        place = np.minimum(np.searchsorted(keys, keys + shift), len(keys) - 1)
        around += np.where(keys[place] == keys + shift, counts[place], 0)
    return np.where(np.abs(positions).max(axis=1) < 1000, around[inverse], 1.0)
