"""Known shapes for tests: boxes and a chair of boxes, as surfaces of cells and as points."""

import numpy as np

from gscomplete.shape.bank.store import BANK_CELLS


def box_cells(sides, cells=BANK_CELLS, at=(0, 0, 0)):
    """Return the surface cells of a box of so many cells, its low corner at ``at``."""
    solid = np.zeros((cells,) * 3, bool)
    low = np.array(at)
    high = low + sides
    solid[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = True
    inner = solid.copy()
    inner[low[0] + 1 : high[0] - 1, low[1] + 1 : high[1] - 1, low[2] + 1 : high[2] - 1] = False
    return inner


def chair_cells():
    """Return a chair: four legs, a seat, a back at low x."""
    c = BANK_CELLS
    chair = np.zeros((c, c, c), bool)
    for x in (8, 36):
        for y in (8, 36):
            chair |= box_cells((4, 4, 24), at=(x, y, 0))
    chair |= box_cells((32, 32, 3), at=(8, 8, 24))
    return chair | box_cells((3, 32, 24), at=(8, 8, 24))


def cell_points(cells):
    """Return the centres of marked cells in the shape's frame."""
    return (np.argwhere(cells) + 0.5) / len(cells) - 0.5
