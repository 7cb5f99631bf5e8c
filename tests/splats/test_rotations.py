"""Rotation matrices of quaternions of any length."""

import pytest
import torch

from gscomplete.splats.rotations import rotation_matrices


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
