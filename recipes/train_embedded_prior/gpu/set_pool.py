"""Training sets of the shape network in a device's memory, unpacked there, batch by batch.

Conventions
-----------
* Sets stay in the eight bits that they are stored in (``shape_dataset.set_dtype``), 213 kB each;
  when the pool is full, new sets take the place of the oldest.
* A batch is drawn at random, in eight parts, each in another orientation.
"""

from __future__ import annotations

import threading

import numpy as np
import torch
from torch import Tensor

from gscomplete.shape.symmetry import SOURCES
from gscomplete.shape.voxels import CELLS
from recipes.train_embedded_prior.data.shape_dataset import (
    MOST_CELLS,
    ShapeBatch,
    joined,
    set_dtype,
    turn_batch,
)

ORIENTATIONS = 8


class SetPool:
    """Sets on a device. One thread may add while another draws."""

    def __init__(self, capacity: int, device: str) -> None:
        """Reserve memory for ``capacity`` sets."""
        self.added = 0
        self._capacity, self._device = capacity, device
        self._lock = threading.Lock()
        self._fields = {
            name: torch.empty((capacity, *shape), dtype=kind, device=device)
            for name, (shape, kind) in _fields().items()
        }

    def __len__(self) -> int:
        return min(self.added, self._capacity)

    def add(self, stored: np.ndarray) -> None:  # [K] of set_dtype
        """Add sets."""
        places = torch.from_numpy(np.arange(self.added, self.added + len(stored)) % self._capacity)
        places = places.to(self._device)
        arriving = {
            name: torch.from_numpy(np.ascontiguousarray(stored[name])).to(self._device)
            for name in self._fields
        }
        with self._lock:
            for name, kept in self._fields.items():
                kept[places] = arriving[name]
            self.added += len(stored)

    def draw(self, count: int, rng: np.random.Generator) -> ShapeBatch:
        """Return random sets, unpacked; ``count`` is a multiple of ``ORIENTATIONS``."""
        chosen = torch.from_numpy(rng.integers(len(self), size=count)).to(self._device)
        with self._lock:
            taken = {name: kept[chosen] for name, kept in self._fields.items()}
        parts = [
            turn_batch(unpacked({k: v[o::ORIENTATIONS] for k, v in taken.items()}), o % 4, o >= 4)
            for o in range(ORIENTATIONS)
        ]
        return joined(parts)


def _fields() -> dict[str, tuple[tuple[int, ...], torch.dtype]]:
    """Return the shapes and kinds of a set's fields."""
    empty = np.zeros((), set_dtype())
    arrays = {name: np.ascontiguousarray(empty[name]) for name in empty.dtype.names or ()}
    return {name: (a.shape, torch.from_numpy(a).dtype) for name, a in arrays.items()}


def unpacked(stored: dict[str, Tensor]) -> ShapeBatch:
    """Turn stored fields, [B, ...] each, into a batch, as ``decode_sets`` does on the CPU."""
    cells = stored["cells"].reshape(-1, MOST_CELLS, 7)
    shifts = torch.arange(7, -1, -1, device=cells.device, dtype=torch.uint8)
    bits = (stored["solid"][:, :, None] >> shifts) & 1
    return ShapeBatch(
        _volumes(cells).unflatten(0, (-1, SOURCES)),
        stored["evidence"].float() / 255,
        stored["scores"],
        stored["tokens"].long(),
        bits.float().reshape(-1, CELLS, CELLS, CELLS),
        _volumes(stored["surface"]),
    )


def _volumes(packed: Tensor) -> Tensor:  # [K, M, 7] bytes -> [K, 4, C, C, C]
    """Undo ``shape_dataset.pack_cells``; rows without occupancy add nothing to the first cell."""
    x, y, z = packed[..., :3].long().unbind(dim=-1)
    place = (x * CELLS + y) * CELLS + z
    values = packed[..., [6, 3, 4, 5]].float().transpose(1, 2) / 255
    volumes = torch.zeros((len(packed), 4, CELLS**3), device=packed.device)
    volumes.scatter_add_(2, place[:, None].expand(-1, 4, -1), values)
    return volumes.unflatten(2, (CELLS, CELLS, CELLS))
