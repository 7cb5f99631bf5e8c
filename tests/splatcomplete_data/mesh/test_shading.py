import numpy as np

from splatcomplete_data.mesh.cells import Cells
from splatcomplete_data.mesh.files.parts import MeshPart
from splatcomplete_data.mesh.shading import shade_cells


def test_colours_are_the_slow_twins() -> None:
    rng = np.random.default_rng(3)
    vertices = rng.normal(size=(5, 3, 3)).astype(np.float32)
    part = MeshPart(
        vertices,
        rng.random((5, 3, 3)).astype(np.float32),
        rng.uniform(-2, 3, (5, 3, 2)).astype(np.float32),
        rng.random((7, 5, 4)).astype(np.float32),
    )
    steps = rng.normal(scale=0.05, size=(300, 2, 3)).astype(np.float32)
    cells = Cells(
        rng.integers(0, 5, 300),
        rng.dirichlet(np.ones(3), 300).astype(np.float32),
        steps - steps.mean(axis=2, keepdims=True),  # weights go on adding up to 1
        np.zeros((300, 2, 3), np.float32),
        np.zeros((300, 2), np.float32),
    )
    found = shade_cells((part,), cells)
    expected = np.zeros_like(found)
    for sx in (-1, 1):
        for sy in (-1, 1):
            weights = cells.weights + sx * cells.steps[:, 0] + sy * cells.steps[:, 1]
            plain = MeshPart(vertices, np.ones_like(part.colors), part.uv, part.texture)
            expected += 0.25 * plain.colors_at(cells.triangle, weights)
    expected[:, :3] *= np.einsum("nk,nkc->nc", cells.weights, part.colors[cells.triangle])
    # float32 places in the texture, times its steepest slope between texels
    np.testing.assert_allclose(found, np.clip(expected, 0, 1), atol=2e-5)


def test_parts_have_their_own_colours_and_alpha() -> None:
    corners = np.zeros((1, 3, 3), np.float32)
    red, blue = (np.tile(np.float32(c), (1, 3, 1)) for c in ([1, 0, 0], [0, 0, 1]))
    parts = (MeshPart(corners, red), MeshPart(corners, blue, alpha=0.25))
    weights = np.full((2, 3), 1 / 3, np.float32)
    blank = np.zeros((2, 2, 3), np.float32)
    cells = Cells(np.array([1, 0]), weights, blank, blank, np.zeros((2, 2), np.float32))
    expected = [[0, 0, 1, 0.25], [1, 0, 0, 1]]
    np.testing.assert_allclose(shade_cells(parts, cells), expected, atol=1e-6)
