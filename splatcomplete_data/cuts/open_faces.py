"""Which faces of a crop box cut through the object: P ends there, but the object does not.

The splats just inside a face and those just outside it are compared where they lie on the face. A
surface that passes through has the same section on both sides; a floor below an object's feet, or a
wall behind it, has another.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gscomplete.splats import Splats, usable_rows
from splatcomplete_data.cuts.boxes import CropBox

_SLAB = 0.02
"""Thickness of what is compared on either side, in the box's largest side."""
_CELLS = 24
"""Sections are compared on a grid of so many cells along the face's sides."""
_FEWEST = 12
"""Smaller sections, in cells, are not told."""
_LEAST_ALIKE = 0.35
"""Least share of the cells of either section that both have."""
_HAZE = 0.3
"""Splats that are no more opaque than this do not count."""
_AXES = "xyz"


def faces_cut_through(
    points: NDArray[np.floating],  # [N, 3]
    box: CropBox,
) -> tuple[str, ...]:
    """Name the faces that cut through what the points are samples of.

    Args:
        points: of the scene, file frame.
        box: what is kept.

    Returns:
        The faces by their outward direction along the box's own axes, such as "-y".
    """
    local = (np.asarray(points, np.float64) - np.asarray(box.center)) @ box.rotation
    half = np.asarray(box.half_extents)
    slab = 2.0 * _SLAB * half.max()
    found = []
    for axis in range(3):
        others = [number for number in range(3) if number != axis]
        beside = (np.abs(local[:, others]) <= half[others]).all(axis=1)
        cells = ((local[beside][:, others] / half[others] + 1.0) * (_CELLS / 2)).astype(np.int64)
        cells = cells.clip(0, _CELLS - 1)
        for sign in (1.0, -1.0):
            beyond = sign * local[beside, axis] - half[axis]
            inside = _section(cells[(beyond <= 0) & (beyond > -slab)])
            outside = _section(cells[(beyond > 0) & (beyond < slab)])
            both, either = (inside & outside).sum(), (inside | outside).sum()
            if both >= _FEWEST and both >= _LEAST_ALIKE * either:
                found.append(("+" if sign > 0 else "-") + _AXES[axis])
    return tuple(found)


def describe_cuts(scene: Splats, boxes: Sequence[CropBox]) -> tuple[str, ...]:
    """Tell users where the box that is kept cuts through the object; no line if it does not.

    Args:
        scene: what is cropped, file frame.
        boxes: with more than one, or none to keep, nothing is said.
    """
    if len(boxes) != 1 or boxes[0].action != "keep":
        return ()
    usable, _ = usable_rows(scene)
    seen = scene.means[usable & (scene.opacities > _HAZE)]
    faces = faces_cut_through(seen.numpy(), boxes[0])
    if not faces:
        return ()
    return (
        f"the box cuts through splats at its {' and '.join(faces)} "
        f"{'face' if len(faces) == 1 else 'faces'}: a larger box keeps what continues there; if "
        "it was not captured, --center and --object-size say where the object ends",
    )


def _section(cells: NDArray[np.int64]) -> NDArray[np.bool_]:  # [M, 2] -> [C, C]
    """Return the cells of a face that points lie in."""
    section = np.zeros((_CELLS, _CELLS), np.bool_)
    section[cells[:, 0], cells[:, 1]] = True
    return section
