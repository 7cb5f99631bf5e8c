import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.render import render
from gscomplete.shape.assemble import select_consistent
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.symmetry import mirror, mirror_image, with_composition
from gscomplete.shape.voxels import CELLS
from gscomplete.splats import Splats
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.views import ViewDistribution
from tests.shape.shapes import half, mirrors, sphere


def some_splats(count: int = 30) -> Splats:
    generator = torch.Generator().manual_seed(0)

    def draw(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator)

    return Splats(
        draw(count, 3) - 0.5,
        torch.nn.functional.normalize(draw(count, 4) - 0.5, dim=1),
        0.02 + 0.1 * draw(count, 3),
        0.2 + 0.7 * draw(count),
        draw(count, 4, 3),
    )


def covariances(splats: Splats) -> torch.Tensor:
    axes = rotation_matrices(splats.quaternions) * splats.scales[:, None]
    return axes @ axes.transpose(1, 2)


@settings(max_examples=30, deadline=None)
@given(st.floats(-math.pi, math.pi), st.floats(-0.4, 0.4), st.booleans())
def test_ellipsoids_are_mirrored(angle, offset, twice):
    one = mirror(angle, offset, 0.5)
    symmetry = with_composition(one, mirror(angle + 1.0, 0.1, 0.5))[2] if twice else one
    splats = some_splats()
    image = mirror_image(splats, symmetry)
    matrix = torch.from_numpy(symmetry.matrix)
    # float32 products of numbers below 0.02
    torch.testing.assert_close(
        covariances(image), matrix @ covariances(splats) @ matrix.T, atol=1e-7, rtol=1e-4
    )
    assert np.allclose(image.means.numpy(), symmetry.apply(splats.means.numpy()))
    assert torch.equal(image.opacities, splats.opacities)
    assert image.sh.shape[1] == 1


def test_the_picture_of_the_image_is_the_mirrored_picture():
    """Seen along y, the mirror image through x = 0 is the picture turned left to right."""
    splats = some_splats().with_sh_degree(0)
    cameras = ViewDistribution(90.0, 0.0).cameras((np.zeros(1) + 90.0, np.zeros(1)), 48)
    pictures = [render(s, cameras).color[0] for s in (splats, mirror_image(splats, mirrors()[0]))]
    # float32 rendering of mirrored pixel centres
    torch.testing.assert_close(pictures[1], pictures[0].flip(1), atol=2e-4, rtol=0)


def test_copies_that_something_speaks_against_are_left_out():
    partial = half(sphere())
    voxels = voxelize_partial(partial, ViewDistribution(0.0, 10.0))
    copies = mirror_image(partial, mirrors()[0])
    everywhere = torch.full((1, CELLS, CELLS, CELLS), 5.0)
    assert len(select_consistent(copies, everywhere, voxels.evidence)) == len(copies)
    left = everywhere.clone()
    left[:, :, : CELLS // 2] = -5.0
    kept = select_consistent(copies, left, voxels.evidence)
    assert 0.4 < len(kept) / len(copies) < 0.6
    assert float(kept.means[:, 1].min()) > -0.02
    # P faces the views: what lies above its surface was seen to be empty, but for the rim.
    above = dataclasses.replace(partial, means=1.2 * partial.means)
    facing = above.select(above.means[:, 0] > 0.42)
    assert len(select_consistent(facing, everywhere, voxels.evidence)) < 0.05 * len(facing)


@pytest.mark.parametrize("count", [0, 1])
def test_few_splats_are_mirrored_too(count):
    splats = some_splats().select(torch.arange(30) < count)
    assert len(mirror_image(splats, mirrors()[0])) == count
