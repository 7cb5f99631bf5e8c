import numpy as np
import torch

from gscomplete.render import render
from gscomplete.shape.bank.cell_splats import cell_splats, cells_passed
from gscomplete.shape.bank.store import BANK_CELLS
from gscomplete.views import four_view_orbit
from tests.builders.known_shapes import box_cells, cell_points


def test_points_of_a_cell_pass_that_cell():
    centers = cell_points(box_cells((48, 10, 4)))
    jitter = np.random.default_rng(0).uniform(-0.49, 0.49, centers.shape) / BANK_CELLS
    found = cells_passed(np.concatenate([centers, centers + jitter]))
    assert np.allclose(found, centers[np.lexsort(centers.T[::-1])])


def test_what_sticks_out_of_the_cube_counts_to_its_rim():
    found = cells_passed(np.array([[0.6, 0.0, -0.7]]))
    assert np.allclose(np.abs(found[0, [0, 2]]), 0.5 - 0.5 / BANK_CELLS)


def test_a_surface_is_closed_when_drawn():
    cameras = four_view_orbit(20.0, 15.0, radius=2.2, fov_deg=40.0, size_px=64)
    for scale in (1.0, 0.6):
        box = cell_splats(scale * cell_points(box_cells((48, 48, 48))), scale)
        alpha = render(box, cameras).alpha
        corner = (
            scale
            * 0.5
            * torch.tensor([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        )
        assert float((alpha[:, 28:36, 28:36]).min()) > 0.9
        reach = (corner.norm(dim=1).max() / 2.2 * cameras.focal_px[0, 0]).item()
        columns = (alpha.amax(dim=(0, 1)) > 0.5).nonzero()
        assert float((columns - 31.5).abs().max()) < reach + 2
