"""Compiled loops between vertex records and the columns of ``Splats``, one pass over a block.

Conventions
-----------
* A table is a block of records whose properties are all float32 of the machine: [B, P].
* ``places`` are the columns of the values in a record: mean (3), scale (3), opacity, quaternion
  (4), then the SH values in the order of ``Splats.sh``.
* Exponentials and logarithms are left to numpy, which has them as vector instructions. Nothing
  here reorders arithmetic: results are those of ``layout``'s numpy path, bit for bit.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from gscomplete.util.arrays import Float32Array

JIT: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
"""Options of the kernels; unsigned indices spare them Python's negative ones."""


@numba.njit(**JIT)
def split_table(
    table: Float32Array,  # [B, P]
    places: NDArray[np.uint64],  # [11 + W]
    means: Float32Array,  # [B, 3] out
    quaternions: Float32Array,  # [B, 4] out, unit
    logs: Float32Array,  # [B, 3] out
    negative_logits: Float32Array,  # [B] out
    sh: Float32Array,  # [B, W] out
) -> None:
    """Copy the values of a block into their arrays; quaternions as ``unit_quaternions``."""
    width = np.uint64(len(places) - 11)
    for i in range(len(table)):
        row, values = table[i], sh[i]
        for axis in range(3):
            means[i, axis] = row[places[axis]]
            logs[i, axis] = row[places[3 + axis]]
        negative_logits[i] = -row[places[6]]
        w, x, y, z = row[places[7]], row[places[8]], row[places[9]], row[places[10]]
        largest = max(max(abs(w), abs(x)), max(abs(y), abs(z)))
        if w == 0 and x == 0 and y == 0 and z == 0:
            w, largest = np.float32(1), np.float32(1)
        w, x, y, z = w / largest, x / largest, y / largest, z / largest
        length = np.sqrt(w * w + x * x + y * y + z * z)
        quaternions[i, 0], quaternions[i, 1] = w / length, x / length
        quaternions[i, 2], quaternions[i, 3] = y / length, z / length
        for j in range(width):
            k = np.uint64(j)
            values[k] = row[places[k + np.uint64(11)]]


@numba.njit(**JIT)
def join_table(
    means: Float32Array,  # [B, 3]
    quaternions: Float32Array,  # [B, 4]
    logs: Float32Array,  # [B, 3] of the scales
    logits: Float32Array,  # [B] of the opacities
    sh: Float32Array,  # [B, W]
    places: NDArray[np.uint64],  # [11 + W]
    table: Float32Array,  # [B, P] out; other columns are left alone
) -> None:
    """Copy the arrays of a block into its records."""
    width = np.uint64(len(places) - 11)
    for i in range(len(table)):
        row, values = table[i], sh[i]
        for axis in range(3):
            row[places[axis]] = means[i, axis]
            row[places[3 + axis]] = logs[i, axis]
        row[places[6]] = logits[i]
        for j in range(4):
            row[places[7 + j]] = quaternions[i, j]
        for j in range(width):
            k = np.uint64(j)
            row[places[k + np.uint64(11)]] = values[k]
