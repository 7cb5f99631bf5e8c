"""Training sets: a pure function of (seed, index), and their form in memory and on disk.

Conventions
-----------
* Set ``index`` shows object ``index`` of its seed, which arrives in the object frame; every random
  number comes from (seed, index), so any set can be made again, alone, on any machine.
* Sets are stored in eight bits: images, colours and alpha as value * 255, relief as
  value * 127 + 127 (zero stays exactly zero).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from gscomplete.priors.embedded.inputs import input_map, network_images, shape_map
from gscomplete.priors.embedded.text import Tokenizer
from gscomplete.render import render
from gscomplete.shape.bank.cell_splats import cell_splats, cells_passed
from gscomplete.splats import Splats
from gscomplete.views.cameras import Cameras, orbit_cameras, radius_to_fit
from recipes.train_embedded_prior.config import DataConfig

HELD_OUT_SEED_OFFSET = 1_000_003
"""Added to the seed for sets that training never sees."""
DISTURBED_SHARE = 0.5
"""Share of sets whose P is disturbed the way real captures are."""
_USUAL_ELEVATION_DEG = (0.0, 30.0)
"""Half of the rings are drawn from this narrower range."""
_CENTER_JITTER = 0.12
"""The target is off the object's centre by up to this along each axis, object frame."""


class TakesPart(Protocol):
    """Takes the object's part."""

    def __call__(self, *, disturb: bool, slight: bool) -> Splats:
        """Return P, with flaws if disturbed, lacking little if slight."""
        ...


@dataclass(frozen=True, slots=True)
class TrainingObject:
    """What a source of objects gives: an object and a way to take parts of it."""

    splats: Splats
    caption: str
    partial: TakesPart


Source = Callable[[int, int], TrainingObject]
"""(seed, object index) -> object; must be picklable for worker processes."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Training sets as the network takes them."""

    images: Tensor  # [B, 4, 4, S, S] in [-1, 1]
    input_map: Tensor  # [B, 4, 5, S, S]
    shape_map: Tensor  # [B, 4, 2, S, S]
    ring: Tensor  # [B, 3] elevation_deg, radius, fov_deg
    tokens: Tensor  # [B, L]

    def to(self, device: torch.device | str) -> Batch:
        """Return the batch on another device."""
        fields = dataclasses.fields(self)
        return Batch(**{f.name: getattr(self, f.name).to(device) for f in fields})


def set_dtype(resolution_px: int, text_length: int) -> np.dtype:
    """Record layout of one stored set."""
    size = (resolution_px, resolution_px)
    return np.dtype(
        [
            ("images", "u1", (4, 4, *size)),
            ("input_map", "u1", (4, 5, *size)),
            ("shape_map", "u1", (4, 2, *size)),
            ("ring", "f4", (3,)),
            ("tokens", "i2", (text_length,)),
        ]
    )


class SetMaker:
    """Make stored sets by index."""

    def __init__(
        self, source: Source, data: DataConfig, tokenizer: Tokenizer, resolution_px: int, seed: int
    ) -> None:
        self._source = source
        self._data = data
        self._tokenizer = tokenizer
        self._resolution_px = resolution_px
        self._seed = seed
        self.dtype = set_dtype(resolution_px, tokenizer.length)

    def __call__(self, index: int) -> np.ndarray:  # [] of dtype
        """Make set ``index``."""
        item = self._source(self._seed, index)
        rng = np.random.default_rng((self._seed, index, 1))
        cameras, ring = sample_ring(self._data, rng)
        disturb = bool(rng.random() < DISTURBED_SHARE)
        partial = item.partial(disturb=disturb, slight=False)
        stored = np.zeros((), self.dtype)
        stored["images"] = self._render_images(item.splats, cameras)
        stored["input_map"] = self._render_input(partial, cameras, float(ring[1]))
        stored["shape_map"] = self._render_shape(item.splats, cameras, float(ring[1]))
        stored["ring"] = ring
        stored["tokens"] = self._tokenizer.encode(item.caption).numpy()
        return stored

    def _render_images(self, splats: Splats, cameras: Cameras) -> np.ndarray:
        seen = render(splats, cameras)
        images = network_images(seen.color, seen.alpha, self._resolution_px)
        return _to_bytes((images + 1) * 127.5)

    def _render_input(self, splats: Splats, cameras: Cameras, radius: float) -> np.ndarray:
        seen = render(splats, cameras)
        mapped = input_map(seen.color, seen.alpha, seen.depth, radius, self._resolution_px)
        return _stored(mapped)

    def _render_shape(self, splats: Splats, cameras: Cameras, radius: float) -> np.ndarray:
        """Draw the object as a known shape: the cells that its surface passes."""
        seen = render(cell_splats(cells_passed(splats.means.double().numpy())), cameras)
        return _stored(shape_map(seen.alpha, seen.depth, radius, self._resolution_px))


def sample_ring(data: DataConfig, rng: np.random.Generator) -> tuple[Cameras, np.ndarray]:
    """Draw a ring of four cameras and its numbers (elevation_deg, radius, fov_deg)."""
    extent = rng.uniform(*data.extent_range)
    usual = rng.random() < 0.5
    span = _USUAL_ELEVATION_DEG if usual else data.elevation_range_deg
    elevation_deg = rng.uniform(*span)
    azimuth_deg = rng.uniform(0, 360)
    target = rng.uniform(-_CENTER_JITTER, _CENTER_JITTER, 3)
    radius = radius_to_fit(extent, data.fov_deg)
    cameras = orbit_cameras(
        azimuth_deg + 90.0 * torch.arange(4, dtype=torch.float64),
        torch.full((4,), elevation_deg, dtype=torch.float64),
        radius=radius,
        fov_deg=data.fov_deg,
        size_px=data.render_px,
        target=torch.from_numpy(target),
    )
    return cameras, np.array([elevation_deg, radius, data.fov_deg], np.float32)


def decode_sets(stored: np.ndarray) -> Batch:  # [B] of set_dtype
    """Turn stored sets into a batch."""
    images = torch.from_numpy(np.ascontiguousarray(stored["images"])).float() / 127.5 - 1
    mapped, shape = (_from_stored(stored[name]) for name in ("input_map", "shape_map"))
    ring = torch.from_numpy(np.ascontiguousarray(stored["ring"]))
    tokens = torch.from_numpy(stored["tokens"].astype(np.int64))
    return Batch(images, mapped, shape, ring, tokens)


def _stored(mapped: Tensor) -> np.ndarray:  # [4, C, S, S], relief last
    return _to_bytes(torch.cat([mapped[:, :-1] * 255, mapped[:, -1:] * 127 + 127], dim=1))


def _from_stored(stored: np.ndarray) -> Tensor:  # [B, 4, C, S, S]
    mapped = torch.from_numpy(np.ascontiguousarray(stored)).float()
    return torch.cat([mapped[:, :, :-1] / 255, (mapped[:, :, -1:] - 127) / 127], dim=2)


def _to_bytes(values: Tensor) -> np.ndarray:
    return values.round().clamp(0, 255).to(torch.uint8).numpy()
