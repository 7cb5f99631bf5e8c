"""Training sets: a pure function of (seed, index), and the batches of every step.

Conventions
-----------
* Set ``index`` shows object ``index // rings_per_object``; every random number of it comes from
  (seed, index), so any set can be made again at any time, alone, on any machine.
* Sets are stored in eight bits: images and P's colour and alpha as value * 255, P's relief as
  value * 127 + 127 (zero stays exactly zero).
* A mirrored set has its images flipped left to right and its views in reverse order: mirroring
  the world turns azimuths round. The ring numbers stay.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gscomplete.priors.embedded.inputs import input_map, network_images
from gscomplete.priors.embedded.text import Tokenizer
from gscomplete.render import render
from gscomplete.splats import Splats
from gscomplete.views.cameras import Cameras, orbit_cameras, radius_to_fit
from recipes.train_embedded_prior.config import DataConfig

HELD_OUT_SEED_OFFSET = 1_000_003
"""Added to the seed for sets that training never sees."""


@dataclass(frozen=True, slots=True)
class TrainingObject:
    """What a source of objects gives: an object and a way to take parts of it."""

    splats: Splats
    caption: str
    partial: Callable[[int, bool], Splats]  # (ring number, disturb it?) -> P


Source = Callable[[int, int], TrainingObject]
"""(seed, object index) -> object; must be picklable for worker processes."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Training sets as the network takes them."""

    images: Tensor  # [B, 4, 4, S, S] in [-1, 1]
    input_map: Tensor  # [B, 4, 5, S, S]
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
            ("ring", "f4", (3,)),
            ("tokens", "i2", (text_length,)),
        ]
    )


class SetMaker:
    """Make stored sets by index, keeping the last object for its next ring."""

    def __init__(
        self, source: Source, data: DataConfig, tokenizer: Tokenizer, resolution_px: int, seed: int
    ) -> None:
        self._source = source
        self._data = data
        self._tokenizer = tokenizer
        self._resolution_px = resolution_px
        self._seed = seed
        self._kept: tuple[int, TrainingObject] | None = None
        self.dtype = set_dtype(resolution_px, tokenizer.length)

    def __call__(self, index: int) -> np.ndarray:  # [] of dtype
        """Make set ``index``."""
        number, ring_number = divmod(index, self._data.rings_per_object)
        if self._kept is None or self._kept[0] != number:
            self._kept = (number, self._source(self._seed, number))
        item = self._kept[1]
        rng = np.random.default_rng((self._seed, index, 1))
        cameras, ring = sample_ring(self._data, rng)
        disturb = bool(rng.random() < self._data.corrupt_share)
        partial = item.partial(ring_number, disturb)
        stored = np.zeros((), self.dtype)
        stored["images"] = self._render_images(_framed(item.splats, item.splats), cameras)
        stored["input_map"] = self._render_input(
            _framed(partial, item.splats), cameras, float(ring[1])
        )
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
        scaled = torch.cat([mapped[:, :4] * 255, mapped[:, 4:] * 127 + 127], dim=1)
        return _to_bytes(scaled)


def sample_ring(data: DataConfig, rng: np.random.Generator) -> tuple[Cameras, np.ndarray]:
    """Draw a ring of four cameras and its numbers (elevation_deg, radius, fov_deg)."""
    extent = rng.uniform(*data.extent_range)
    usual = rng.random() < 0.5
    span = data.elevation_usual_deg if usual else data.elevation_range_deg
    elevation_deg = rng.uniform(*span)
    azimuth_deg = rng.uniform(0, 360)
    target = rng.uniform(-data.center_jitter, data.center_jitter, 3)
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


def decode_sets(stored: np.ndarray, mirror: np.ndarray) -> Batch:  # [B] of set_dtype, [B] bool
    """Turn stored sets into a batch, mirrored where asked."""
    images = torch.from_numpy(np.ascontiguousarray(stored["images"])).float() / 127.5 - 1
    mapped = torch.from_numpy(np.ascontiguousarray(stored["input_map"])).float()
    mapped = torch.cat([mapped[:, :, :4] / 255, (mapped[:, :, 4:] - 127) / 127], dim=2)
    flip = torch.from_numpy(mirror)
    images[flip] = images[flip].flip(1, 4)
    mapped[flip] = mapped[flip].flip(1, 4)
    ring = torch.from_numpy(np.ascontiguousarray(stored["ring"]))
    tokens = torch.from_numpy(stored["tokens"].astype(np.int64))
    return Batch(images, mapped, ring, tokens)


def plan_step(
    seed: int, step: int, batch_sets: int, fresh_sets: int
) -> tuple[np.ndarray, np.ndarray]:
    """Choose the sets of a step: the next fresh ones, and some of those seen before.

    Returns:
        Indices [B] and mirror flags [B]; fresh sets are not mirrored, repeated ones half the time.
    """
    rng = np.random.default_rng((seed, step, 2))
    first = step * fresh_sets
    fresh = np.arange(first, first + fresh_sets)
    repeats = batch_sets - fresh_sets
    seen = rng.integers(0, max(first, 1) if first else fresh_sets, repeats)
    mirror = np.concatenate([np.zeros(fresh_sets, bool), rng.random(repeats) < 0.5])
    return np.concatenate([fresh, seen]), mirror


def _framed(splats: Splats, whole: Splats) -> Splats:
    """Move and scale so that the whole object's box is centred with largest side 1."""
    low, high = whole.bounds()
    factor = 1.0 / float((high - low).max().clamp(min=1e-6))
    return dataclasses.replace(
        splats, means=(splats.means - (low + high) / 2) * factor, scales=splats.scales * factor
    )


def _to_bytes(values: Tensor) -> np.ndarray:
    return values.round().clamp(0, 255).to(torch.uint8).numpy()
