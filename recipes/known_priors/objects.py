"""Parts of real meshes, and the complete objects that a prior of known strength believes in.

Conventions
-----------
* Objects are those of ``real_objects.unseen`` (validation split), in their true object frame, so
  that framing errors do not enter the measures.
* Parts alternate between one scanner view and an upright half; V is 50 degrees to either side of
  the azimuth that the part was taken from, as in the paper.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gscomplete.priors.base import PriorViews
from gscomplete.splats import Splats, colors_to_sh, transform_splats
from gscomplete.views import ObjectFrame, ViewDistribution, radius_to_fit
from recipes.known_priors.priors import Kind
from recipes.real_objects.unseen import chosen_entries, complete_object, seen_from
from recipes.train_embedded_prior.data.mesh_pack import read_mesh
from splatcomplete_data.cuts.geometry import by_plane

_ELEVATION_DEG = 15.0
_GROWTH = 1.08
"""How much larger the biased prior's object is."""
_BIAS_TINT = (1.0, 0.55, 0.55)
_VARIANTS = ((0.0, (1.0, 1.0, 1.0)), (-0.3, (1.0, 0.8, 0.6)), (0.3, (0.6, 0.8, 1.0)))
"""Stretch of what lies behind, and tint, of the plausible prior's objects."""


@dataclass(frozen=True, slots=True)
class KnownObject:
    """A part whose complete object is known, object frame."""

    name: str
    kind: str
    """``scan`` or ``half``."""
    partial: Splats
    truth: Splats
    hidden: Tensor  # [N] bool, splats of the truth that P lacks
    views: ViewDistribution
    prompt: str = ""


def known_objects(meshes: Path, count: int, lens: PriorViews) -> list[KnownObject]:
    """Make the parts.

    Args:
        meshes: folder of the pack.
        count: of objects, spread over the validation split.
        lens: framing of the views.

    Raises:
        UserError: the folder has no manifest, or a mesh cannot be read.
    """
    found = []
    for number, entry in enumerate(chosen_entries(meshes, count)):
        splats = complete_object(read_mesh(meshes, entry), entry, 0.0)
        frame = ObjectFrame.about(splats, "Z")
        truth = transform_splats(splats, frame.object_from_file).with_sh_degree(0)
        rng = np.random.default_rng((7, number))
        azimuth_deg = float(rng.uniform(0, 360))
        kind = "scan" if number % 2 == 0 else "half"
        kept = _kept(truth, kind, azimuth_deg)
        radius = radius_to_fit(lens.mean_extent, lens.fov_deg)
        views = ViewDistribution(
            azimuth_deg=azimuth_deg,
            elevation_deg=_ELEVATION_DEG,
            radius=radius,
            fov_deg=lens.fov_deg,
        )
        found.append(
            KnownObject(entry.id, kind, truth.select(kept), truth, ~kept, views, entry.caption)
        )
    return found


def _kept(truth: Splats, kind: str, azimuth_deg: float) -> Tensor:  # [N] bool
    """Cut a complete object as seen from an azimuth."""
    azimuth = math.radians(azimuth_deg)
    if kind == "half":
        return by_plane(truth, (math.cos(azimuth), math.sin(azimuth), 0.0), 0.0).mask
    return seen_from(truth, azimuth, math.radians(_ELEVATION_DEG))


def believed(item: KnownObject, kind: Kind) -> tuple[Splats, ...]:
    """Return the complete objects that a kind of prior answers with."""
    if kind == "plausible":
        return tuple(_variant(item, stretch, tint) for stretch, tint in _VARIANTS)
    if kind == "biased":
        truth = item.truth
        larger = dataclasses.replace(
            truth, means=truth.means * _GROWTH, scales=truth.scales * _GROWTH
        )
        return (_tinted(larger, torch.ones(len(truth), dtype=torch.bool), _BIAS_TINT),)
    return (item.truth,)


def _variant(item: KnownObject, stretch: float, tint: tuple[float, float, float]) -> Splats:
    """Stretch what lies behind the middle of the truth as seen from c, and tint what P lacks."""
    azimuth = math.radians(item.views.azimuth_deg)
    away = torch.tensor([-math.cos(azimuth), -math.sin(azimuth), 0.0])
    behind = (item.truth.means @ away).clamp_min(0.0)
    means = item.truth.means + stretch * (behind * item.hidden)[:, None] * away
    return _tinted(dataclasses.replace(item.truth, means=means), item.hidden, tint)


def _tinted(splats: Splats, where: Tensor, tint: tuple[float, float, float]) -> Splats:
    """Multiply the colours of some splats."""
    factor = torch.where(where[:, None], torch.tensor(tint), torch.ones(3))
    return dataclasses.replace(splats, sh=colors_to_sh(splats.base_colors.clamp(0, 1) * factor))
