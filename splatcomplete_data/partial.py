"""Cut complete objects into partial ones, and give them the flaws of real captures.

Conventions
-----------
* A cut never changes splats: it returns a mask of what is kept, its kind, and its parameters.
* Random cuts and flaws are pure functions of (seed, index) and of the splats. They expect the
  object frame (centred, largest side 1), as do defaults given in units of length.
* Cameras that "see" are points in the frame of the splats; nothing is rendered.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numba
import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from gscomplete.splats.record import SH_C0, Splats, concatenate

CutKind = Literal["plane", "box", "visibility", "crop", "plane+box", "plane+visibility"]
FloatArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class PartialCut:
    """What a cut keeps and why."""

    mask: Tensor  # [N] bool, True = kept
    kind: CutKind
    details: Mapping[str, object] = field(default_factory=dict)

    @property
    def kept(self) -> int:
        """Number of splats kept."""
        return int(self.mask.sum())

    @property
    def reason(self) -> str:
        """One line for logs: kind, counts and parameters."""
        numbers = ", ".join(f"{name} {value}" for name, value in self.details.items())
        return f"{self.kind}: kept {self.kept} of {len(self.mask)} splats ({numbers})"


@dataclass(frozen=True, slots=True)
class CutSettings:
    """Knobs of ``random_partial``."""

    keep_share: tuple[float, float] = (0.35, 0.75)
    """Share of splats that plane cuts keep."""
    fewest_share: float = 0.12
    """A cut that keeps less is replaced by a plane cut."""
    most_share: float = 0.92
    """A cut that keeps more is replaced by a plane cut."""
    scan_elevation_deg: tuple[float, float] = (-10.0, 45.0)
    """Elevations of the scanner's views."""
    weights: tuple[float, float, float, float, float] = (0.42, 0.18, 0.25, 0.08, 0.07)
    """Shares of plane, box, visibility, plane+box and plane+visibility."""


@dataclass(frozen=True, slots=True)
class FlawSettings:
    """Knobs of ``corrupt``; each flaw's strength is drawn between none and its largest value."""

    clean_share: float = 0.35
    """Share of partials left as they are."""
    position_noise: float = 0.006
    """Largest standard deviation of positions, object frame."""
    color_noise: float = 0.06
    """Largest standard deviation of colours, sRGB."""
    color_shift: float = 0.06
    """Largest shift of all colours together, sRGB."""
    size_noise: float = 0.3
    """Largest standard deviation of log scales."""
    most_holes: int = 4
    """Most round patches dropped."""
    hole_radius: tuple[float, float] = (0.03, 0.12)
    """Radius of dropped patches, object frame."""
    flying_share: float = 0.01
    """Largest share of flying splats added."""


def _points(splats: Splats) -> FloatArray:
    """Return the means as numpy [N, 3]."""
    return splats.means.detach().cpu().float().numpy()


def _cut(splats: Splats, mask: BoolArray, kind: CutKind, **details: object) -> PartialCut:
    """Put a numpy mask on the splats' device and record how it came about."""
    tensor = torch.from_numpy(np.ascontiguousarray(mask)).to(splats.means.device)
    return PartialCut(tensor, kind, details)


def by_plane(splats: Splats, normal: ArrayLike, offset: float) -> PartialCut:
    """Keep the splats with ``normal . x >= offset`` (normal [3], scaled to unit length here).

    Raises:
        ValueError: the normal is zero or not finite.
    """
    direction = np.asarray(normal, np.float64)
    length = float(np.linalg.norm(direction))
    if not (math.isfinite(length) and length > 0):
        raise ValueError(f"by_plane: expected a finite, non-zero normal, found {direction}")
    direction = direction / length
    mask = _points(splats) @ direction.astype(np.float32) >= offset
    return _cut(splats, mask, "plane", normal=direction.round(4).tolist(), offset=round(offset, 4))


def by_box(
    splats: Splats,
    center: ArrayLike,  # [3]
    size: ArrayLike,  # [3] edge lengths
    *,
    turn: ArrayLike | None = None,  # [3, 3] columns are the box's axes, None = axis-aligned
    keep: Literal["inside", "outside"] = "inside",
) -> PartialCut:
    """Keep the splats inside or outside an oriented box."""
    offset = _points(splats) - np.asarray(center, np.float32)
    if turn is not None:
        offset = offset @ np.asarray(turn, np.float32)
    inside: BoolArray = np.all(np.abs(offset) <= 0.5 * np.asarray(size, np.float32), axis=1)
    mask = inside if keep == "inside" else ~inside
    found = np.asarray(center, np.float64).round(4).tolist()
    edges = np.asarray(size, np.float64).round(4).tolist()
    return _cut(splats, mask, "box", keep=keep, center=found, size=edges)


def crop(splats: Splats, low: ArrayLike, high: ArrayLike) -> PartialCut:
    """Keep the splats inside an axis-aligned box given by its corners [3] and [3]."""
    points = _points(splats)
    mask: BoolArray = np.all((points >= np.asarray(low)) & (points <= np.asarray(high)), axis=1)
    low_list = np.asarray(low, np.float64).round(4).tolist()
    high_list = np.asarray(high, np.float64).round(4).tolist()
    return _cut(splats, mask, "crop", low=low_list, high=high_list)


def by_visibility(
    splats: Splats,
    positions: ArrayLike,  # [V, 3] camera centres
    *,
    grid_px: int = 160,
    fov_deg: float = 60.0,
    tolerance: float | None = None,
) -> PartialCut:
    """Keep the splats that at least one camera, looking at the box's centre, sees first.

    Every splat is drawn as a square of its footprint into a coarse depth image; a splat is seen
    where it is not deeper than the nearest one by more than the tolerance. Very faint splats
    (opacity below 0.2) neither hide nor are hidden.

    Args:
        splats: the object.
        positions: camera centres, outside the object.
        grid_px: side of the depth image.
        fov_deg: field of view; widened where the object would not fit.
        tolerance: depth slack, None = three median tangent sizes.

    Raises:
        ValueError: positions are not [V, 3].
    """
    eyes = np.atleast_2d(np.asarray(positions, np.float64))
    if eyes.ndim != 2 or eyes.shape[1] != 3:
        raise ValueError(f"by_visibility: expected positions (V, 3), found {eyes.shape}")
    points = _points(splats)
    if len(points) == 0:
        return _cut(splats, np.zeros(0, np.bool_), "visibility", views=len(eyes))
    sizes = splats.scales.detach().amax(dim=1).cpu().float().numpy()
    slack = 3.0 * float(np.median(sizes)) if tolerance is None else tolerance
    solid = (splats.opacities.detach() >= 0.2).cpu().numpy()
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    reach = float(np.linalg.norm(points - middle, axis=1).max())
    seen = np.zeros(len(points), np.bool_)
    for eye in eyes:
        distance = float(np.linalg.norm(eye - middle))
        half = max(math.tan(math.radians(fov_deg) / 2), 1.05 * reach / max(distance - reach, 1e-3))
        rotation = _looking(eye, middle).astype(np.float32)
        local = (points - eye.astype(np.float32)) @ rotation.T
        seen |= _first_surface(local, sizes, solid, grid_px, 0.5 * grid_px / half, slack)
    return _cut(splats, seen, "visibility", views=len(eyes), eyes=eyes.round(3).tolist())


def _looking(eye: NDArray[np.float64], target: ArrayLike) -> NDArray[np.float64]:
    """Return the rotation [3, 3] into camera axes (x right, y down, z forward), z up."""
    forward = np.asarray(target, np.float64) - eye
    forward /= max(float(np.linalg.norm(forward)), 1e-12)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


@numba.njit(cache=True)
def _first_surface(
    local: FloatArray,  # [N, 3] camera axes
    sizes: FloatArray,  # [N]
    solid: BoolArray,  # [N]
    grid_px: int,
    focal_px: float,
    slack: float,
) -> BoolArray:  # [N]
    """Return which points lie on the nearest surface of a depth image they draw themselves."""
    depth = np.full((grid_px, grid_px), np.inf, np.float32)
    count = len(local)
    seen = np.zeros(count, np.bool_)
    for n in range(count):
        z = local[n, 2]
        if z <= 1e-4 or not solid[n]:
            continue
        x = focal_px * local[n, 0] / z + 0.5 * grid_px
        y = focal_px * local[n, 1] / z + 0.5 * grid_px
        reach = min(1.2 * sizes[n] * focal_px / z, 6.0)
        if not (-1e6 < x < 1e6 and -1e6 < y < 1e6):
            continue
        for row in range(max(int(y - reach), 0), min(int(y + reach) + 1, grid_px)):
            for column in range(max(int(x - reach), 0), min(int(x + reach) + 1, grid_px)):
                depth[row, column] = min(depth[row, column], z)
    for n in range(count):
        z = local[n, 2]
        if z <= 1e-4:
            continue
        column = int(focal_px * local[n, 0] / z + 0.5 * grid_px)
        row = int(focal_px * local[n, 1] / z + 0.5 * grid_px)
        if 0 <= row < grid_px and 0 <= column < grid_px:
            seen[n] = z <= depth[row, column] + slack
    return seen


def _random_direction(rng: np.random.Generator) -> FloatArray:  # [3]
    """Draw a unit vector; half of the time along an axis or level, as people cut."""
    kind = rng.random()
    angle = rng.uniform(0, 2 * math.pi)
    if kind < 0.5:
        return np.array([math.cos(angle), math.sin(angle), 0.0], np.float32)
    if kind < 0.65:
        return np.array([0.0, 0.0, 1.0 if kind < 0.58 else -1.0], np.float32)
    direction = rng.normal(size=3)
    return (direction / np.linalg.norm(direction)).astype(np.float32)


def _random_plane(splats: Splats, rng: np.random.Generator, share: float) -> PartialCut:
    """Cut by a random plane that keeps about ``share`` of the splats."""
    normal = _random_direction(rng)
    along = _points(splats) @ normal
    return by_plane(splats, normal, float(np.quantile(along, 1.0 - share)))


def _random_box(splats: Splats, rng: np.random.Generator) -> PartialCut:
    """Take away a corner or a hole, or keep a slab."""
    angle = rng.uniform(0, 2 * math.pi)
    cos, sin = math.cos(angle), math.sin(angle)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]], np.float32)
    points = _points(splats)
    anchor = points[int(rng.integers(len(points)))]
    kind = rng.integers(3)
    if kind == 0:
        size, keep = rng.uniform(0.35, 0.8, 3), "outside"
    elif kind == 1:
        size, keep = rng.uniform(0.3, 0.7, 3) * np.array([1, 9, 9]), "inside"
        size[0] = rng.uniform(0.3, 0.6)
    else:
        size, keep = rng.uniform(0.25, 0.45, 3) * np.array([1, 1, 9]), "outside"
    return by_box(splats, anchor, size, turn=turn, keep=keep)  # type: ignore[arg-type]


def _random_scan(splats: Splats, rng: np.random.Generator, bounds: Sequence[float]) -> PartialCut:
    """See the object from one to three views within a sector, as a hand-held scanner does."""
    count = int(rng.choice([1, 2, 3], p=[0.5, 0.3, 0.2]))
    azimuth = rng.uniform(0, 2 * math.pi) + np.cumsum(rng.uniform(0.3, 1.0, count))
    elevation = np.radians(rng.uniform(bounds[0], bounds[1], count))
    eyes = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=1,
    )
    return by_visibility(splats, eyes * rng.uniform(1.6, 2.6), fov_deg=30.0)


def random_partial(
    splats: Splats, seed: int, index: int, settings: CutSettings | None = None
) -> PartialCut:
    """Cut an object at random: planes, boxes, scanner views, or two of them.

    Args:
        splats: a complete object in the object frame.
        seed: seed of the stream.
        index: which cut of the stream.
        settings: None = defaults.

    Raises:
        ValueError: there are no splats.
    """
    if len(splats) == 0:
        raise ValueError("random_partial: no splats to cut")
    chosen = settings or CutSettings()
    rng = np.random.default_rng((seed, index, 11))
    kind = int(np.searchsorted(np.cumsum(chosen.weights), rng.random(), side="right"))
    low, high = chosen.keep_share
    share = float(rng.uniform(low, high))
    cuts: list[PartialCut]
    if kind == 0:
        cuts = [_random_plane(splats, rng, share)]
    elif kind == 1:
        cuts = [_random_box(splats, rng)]
    elif kind == 2:
        cuts = [_random_scan(splats, rng, chosen.scan_elevation_deg)]
    elif kind == 3:
        cuts = [_random_plane(splats, rng, 0.5 + 0.5 * share), _random_box(splats, rng)]
    else:
        scan = _random_scan(splats, rng, chosen.scan_elevation_deg)
        cuts = [_random_plane(splats, rng, 0.5 + 0.5 * share), scan]
    mask = torch.stack([cut.mask for cut in cuts]).all(dim=0)
    kept = float(mask.float().mean())
    if not chosen.fewest_share <= kept <= chosen.most_share:
        return _random_plane(splats, rng, share)
    if len(cuts) == 1:
        return cuts[0]
    details = {name: value for cut in cuts for name, value in cut.details.items()}
    return PartialCut(mask, "plane+box" if kind == 3 else "plane+visibility", details)


def corrupt(
    splats: Splats, mask: Tensor, seed: int, index: int, settings: FlawSettings | None = None
) -> Splats:
    """Return the kept splats with flaws of real captures.

    Flaws: noise of positions, colours and sizes, a shift of all colours, round holes, and a few
    flying splats. A share of all results is left clean.

    Args:
        splats: the complete object, object frame.
        mask: [N] bool, what the partial keeps.
        seed: seed of the stream.
        index: which one of the stream.
        settings: None = defaults.
    """
    chosen = settings or FlawSettings()
    rng = np.random.default_rng((seed, index, 12))
    kept = splats.select(mask)
    if len(kept) == 0 or rng.random() < chosen.clean_share:
        return kept
    strength = rng.random(6) ** 2
    points = _points(kept)
    whole = np.ones(len(points), np.bool_)
    for _ in range(int(rng.integers(chosen.most_holes + 1))):
        middle = points[int(rng.integers(len(points)))]
        radius = rng.uniform(*chosen.hole_radius)
        whole &= np.square(points - middle).sum(axis=1) > radius * radius
    if whole.mean() > 0.5:
        kept = kept.select(torch.from_numpy(whole).to(mask.device))
    shape = (len(kept), 3)

    def noise(deviation: float, size: tuple[int, ...] = shape) -> Tensor:
        draw = rng.standard_normal(size, dtype=np.float32) * np.float32(deviation)
        return torch.from_numpy(draw).to(kept.means)

    sh = kept.sh.clone()
    shift = torch.from_numpy(rng.uniform(-1, 1, 3).astype(np.float32)).to(sh)
    sh[:, 0] += shift * float(strength[0] * chosen.color_shift / SH_C0)
    sh[:, 0] += noise(strength[1] * chosen.color_noise / SH_C0)
    sizes = kept.scales * noise(strength[2] * chosen.size_noise, (len(kept), 1)).exp()
    means = kept.means + noise(strength[3] * chosen.position_noise)
    flawed = dataclasses.replace(kept, means=means, scales=sizes, sh=sh)
    flying = int(strength[4] * chosen.flying_share * len(kept))
    if flying == 0:
        return flawed
    strays = flawed.select(torch.from_numpy(rng.integers(len(kept), size=flying)).to(mask.device))
    away = noise(0.15, (flying, 3))
    return concatenate([flawed, dataclasses.replace(strays, means=strays.means + away)])
