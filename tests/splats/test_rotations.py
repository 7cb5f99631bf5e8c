"""Quaternions of any length, to rotation matrices and directions and from directions."""

import pytest
import torch

from gscomplete.splats.rotations import quaternions_facing, rotation_matrices, thinnest_axes


@pytest.mark.parametrize("length", [1e-44, 1e-30, 1.0, 1e30, 3e38])
def test_any_length_gives_the_rotation(length):
    """Squares of 1e30 and 1e-30 are not float32 numbers."""
    half = torch.tensor([[1.0, 1.0, 0.0, 0.0]])
    expected = torch.tensor([[[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]])
    assert torch.allclose(rotation_matrices(half * length), expected, atol=1e-6)


def test_zero_is_no_rotation_and_gradients_are_finite():
    quaternions = torch.tensor([[0.0] * 4, [1e30, 0, 1e30, 0]], requires_grad=True)
    matrices = rotation_matrices(quaternions)
    assert torch.equal(matrices[0], torch.eye(3))
    matrices.square().sum().backward()
    assert torch.isfinite(quaternions.grad).all()


@pytest.mark.parametrize("thinnest", [0, 1, 2])
def test_the_thinnest_axis_is_the_column_of_the_smallest_scale(thinnest):
    generator = torch.Generator().manual_seed(3)
    quaternions = torch.randn(20, 4, generator=generator, dtype=torch.float64)
    scales = torch.ones(20, 3)
    scales[:, thinnest] = 0.1
    found = thinnest_axes(quaternions, scales)
    assert torch.equal(found, rotation_matrices(quaternions)[:, :, thinnest])


def test_a_disc_is_thinnest_along_the_normal_that_it_faces():
    generator = torch.Generator().manual_seed(4)
    normals = torch.nn.functional.normalize(torch.randn(20, 3, generator=generator), dim=1)
    flat = torch.tensor([1.0, 1.0, 0.1]).expand(20, 3)
    along = (thinnest_axes(quaternions_facing(normals), flat) * normals).sum(dim=1)
    assert torch.allclose(along.abs(), torch.ones(20), atol=1e-6)  # float32, either sign
