"""Spherical harmonics: against closed forms, orthonormality, rotation."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.splats.sh import evaluate_sh, rotate_sh, sh_basis, sh_rotation


def random_rotation(seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    matrix, _ = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))
    return matrix * torch.sign(torch.linalg.det(matrix))


def random_directions(count: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    vectors = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    return torch.nn.functional.normalize(vectors, dim=1)


def associated_legendre(l: int, m: int, z: float) -> float:  # noqa: E741
    """With the Condon-Shortley sign, by the textbook recurrences."""
    value = (-1) ** m * math.prod(range(1, 2 * m, 2)) * (1 - z * z) ** (m / 2)
    below = 0.0
    for n in range(m + 1, l + 1):
        value, below = ((2 * n - 1) * z * value - (n + m - 1) * below) / (n - m), value
    return value


def test_basis_equals_the_textbook_definition():
    for x, y, z in random_directions(20).tolist():
        basis = sh_basis(torch.tensor([x, y, z], dtype=torch.float64), 3)
        angle = math.atan2(y, x)
        for l in range(4):  # noqa: E741
            for m in range(-l, l + 1):
                n = abs(m)
                factor = (2 * l + 1) / (4 * math.pi) * math.factorial(l - n) / math.factorial(l + n)
                value = math.sqrt(factor) * associated_legendre(l, n, z)
                if m > 0:
                    value *= math.sqrt(2) * math.cos(n * angle)
                elif m < 0:
                    value *= math.sqrt(2) * math.sin(n * angle)
                assert basis[l * l + l + m].item() == pytest.approx(value, abs=1e-12), (l, m)


def test_basis_has_the_constants_of_the_original_code():
    basis = sh_basis(torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64), 3)
    assert basis[1].item() == pytest.approx(-0.4886025119029199 * 2)
    assert basis[6].item() == pytest.approx(0.31539156525252005 * (18 - 1 - 4))
    assert basis[9].item() == pytest.approx(-0.5900435899266435 * 2 * (3 - 4))
    assert basis[12].item() == pytest.approx(0.3731763325901154 * 3 * (18 - 3 - 12))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), degree=st.integers(0, 3))
def test_rotated_function_at_rotated_directions(seed, degree):
    rotation = random_rotation(seed)
    generator = torch.Generator().manual_seed(seed + 1)
    sh = torch.randn(5, (degree + 1) ** 2, 3, generator=generator, dtype=torch.float64)
    directions = random_directions(5, seed)
    before = evaluate_sh(sh, directions)
    after = evaluate_sh(rotate_sh(sh, rotation), directions @ rotation.T)
    assert (before - after).abs().max() < 1e-10


def test_rotation_matrices_are_orthogonal_and_compose():
    a, b = random_rotation(1), random_rotation(2)
    whole = sh_rotation(a, 3)
    assert torch.allclose(whole @ whole.T, torch.eye(16, dtype=torch.float64), atol=1e-12)
    assert torch.allclose(sh_rotation(a @ b, 3), whole @ sh_rotation(b, 3), atol=1e-12)


def test_degree_is_checked():
    with pytest.raises(ValueError, match="degree"):
        sh_basis(torch.zeros(1, 3), 4)
