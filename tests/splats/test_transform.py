"""Transforms: group laws, JSON, and splats that look the same or are stretched in the new frame."""

import dataclasses
import json

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.splats.record import Splats
from gscomplete.splats.sh import evaluate_sh
from gscomplete.splats.transform import (
    Similarity,
    multiply_quaternions,
    quaternion_from_rotation,
    stretch_splats,
    transform_splats,
)
from tests.builders.objects import random_splats

HALF_TURNS = [torch.diag(torch.tensor(d)) for d in ([1.0, -1, -1], [-1.0, 1, -1], [-1.0, -1, 1])]


def matrix_of(quaternion: torch.Tensor) -> torch.Tensor:
    """Rotate the three axes by q v q*: the slow obvious matrix."""
    conjugate = quaternion * torch.tensor([1, -1, -1, -1])
    columns = []
    for axis in range(3):
        vector = torch.zeros(4, dtype=quaternion.dtype)
        vector[1 + axis] = 1
        columns.append(multiply_quaternions(multiply_quaternions(quaternion, vector), conjugate))
    return torch.stack(columns, dim=1)[1:]


def colors_seen_from(place: torch.Tensor, splats: Splats) -> torch.Tensor:  # [3] -> [N, 3]
    directions = torch.nn.functional.normalize(splats.means - place, dim=1)
    return 0.5 + evaluate_sh(splats.sh, directions)


def random_similarity(seed: int) -> Similarity:
    generator = torch.Generator().manual_seed(seed)
    quaternion = torch.randn(4, generator=generator, dtype=torch.float64)
    scale = 10 ** (4 * torch.rand(1, generator=generator).item() - 2)
    translation = torch.randn(3, generator=generator, dtype=torch.float64) * 10
    return Similarity(scale, matrix_of(quaternion / quaternion.norm()), translation)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_group_laws(seed):
    a, b = random_similarity(seed), random_similarity(seed + 1)
    points = torch.randn(7, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    assert torch.allclose(a.compose(b).apply(points), a.apply(b.apply(points)), atol=1e-9)
    assert torch.allclose(a.inverse().apply(a.apply(points)), points, atol=1e-9)


def test_apply_keeps_dtype_and_is_exact_in_float32():
    far = Similarity(1.0, torch.eye(3), torch.tensor([1e6, 0.0, 0.0]))
    point = torch.tensor([[-1e6, 0.25, 0.0]])
    moved = far.apply(point)
    assert moved.dtype == torch.float32
    assert moved.tolist() == [[0.0, 0.25, 0.0]]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_json_gives_the_same_bits(seed):
    similarity = random_similarity(seed)
    again = Similarity.from_json(json.loads(json.dumps(similarity.to_json())))
    assert again.scale == similarity.scale
    assert torch.equal(again.rotation, similarity.rotation)
    assert torch.equal(again.translation, similarity.translation)


@pytest.mark.parametrize(
    ("scale", "rotation", "translation"),
    [
        (0.0, torch.eye(3), torch.zeros(3)),
        (float("inf"), torch.eye(3), torch.zeros(3)),
        (1.0, -torch.eye(3), torch.zeros(3)),
        (1.0, 2 * torch.eye(3), torch.zeros(3)),
        (1.0, torch.eye(3) * float("nan"), torch.zeros(3)),
        (1.0, torch.eye(4), torch.zeros(3)),
        (1.0, torch.eye(3), torch.full((3,), float("nan"))),
    ],
)
def test_what_is_no_similarity(scale, rotation, translation):
    with pytest.raises(ValueError, match="Similarity"):
        Similarity(scale, rotation, translation)


def test_json_that_is_no_similarity():
    with pytest.raises(ValueError, match="similarity"):
        Similarity.from_json({"scale": 1.0})
    with pytest.raises(ValueError, match="similarity"):
        Similarity.from_json({"scale": None, "rotation": torch.eye(3).tolist(), "translation": []})


@pytest.mark.parametrize("seed", range(20))
def test_quaternion_and_matrix_agree(seed):
    rotation = random_similarity(seed).rotation
    assert torch.allclose(matrix_of(quaternion_from_rotation(rotation)), rotation, atol=1e-12)


@pytest.mark.parametrize("rotation", [torch.eye(3), *HALF_TURNS])
def test_quaternion_of_half_turns(rotation):
    found = matrix_of(quaternion_from_rotation(rotation))
    assert torch.allclose(found, rotation.double(), atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_transformed_splats_look_the_same(seed):
    splats = random_splats(6, 3, seed, scale=1.0).to(dtype=torch.float64)
    unit = torch.nn.functional.normalize(splats.quaternions, dim=1)
    splats, similarity = dataclasses.replace(splats, quaternions=unit), random_similarity(seed)
    moved = transform_splats(splats, similarity)
    camera = torch.tensor([3.0, -2.0, 5.0], dtype=torch.float64)
    before = colors_seen_from(camera, splats)
    after = colors_seen_from(similarity.apply(camera), moved)
    assert torch.allclose(before, after, atol=1e-8)
    for i in range(6):
        axes = matrix_of(splats.quaternions[i]) * splats.scales[i]
        expected = similarity.scale * similarity.rotation @ axes
        found = matrix_of(moved.quaternions[i]) * moved.scales[i]
        assert torch.allclose(found @ found.T, expected @ expected.T, rtol=1e-9)
    back = transform_splats(moved, similarity.inverse())
    for (name, a), (_, b) in zip(splats.fields(), back.fields(), strict=True):
        assert torch.allclose(a, b, atol=1e-8) or name == "quaternions", name


def test_scales_beyond_the_range_of_float32_lose_no_splat():
    """A factor of 1e44 is infinite in float32; what it multiplies may be 1e-44."""
    tiny = Splats(
        torch.zeros(1, 3),
        torch.tensor([[1.0, 0, 0, 0]]),
        torch.full((1, 3), 1e-43),
        torch.ones(1),
        torch.zeros(1, 1, 3),
    )
    there = transform_splats(tiny, Similarity(1e44, torch.eye(3), torch.zeros(3)))
    assert torch.allclose(there.scales, torch.tensor(10.0), rtol=0.01)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), factor=st.floats(0.05, 20.0))
def test_stretched_splats_keep_their_gaussians(seed, factor):
    splats = random_splats(6, 1, seed, scale=1.0).to(dtype=torch.float64)
    turn = random_similarity(seed).rotation
    matrix = turn @ torch.diag(torch.tensor([factor, 1.0, 1.0], dtype=torch.float64)) @ turn.T
    there = stretch_splats(splats, matrix)
    back = stretch_splats(there, torch.linalg.inv(matrix))
    assert torch.allclose(there.means, splats.means @ matrix.T)
    assert (there.scales[:, 2] <= there.scales.amin(dim=1)).all()
    for i in range(6):
        unit = torch.nn.functional.normalize(splats.quaternions[i], dim=0)
        axes = matrix_of(unit) * splats.scales[i]
        expected = matrix @ axes @ axes.T @ matrix.T
        found = matrix_of(there.quaternions[i]) * there.scales[i]
        # eigenvalues are right to 1e-16 of the largest; squares of factors reach 400
        error = (found @ found.T - expected).norm() / expected.norm()
        assert error < 1e-12
        returned = matrix_of(back.quaternions[i]) * back.scales[i]
        assert (returned @ returned.T - axes @ axes.T).norm() < 1e-9 * (axes @ axes.T).norm()
    assert torch.equal(there.sh, splats.sh)
    assert torch.equal(there.opacities, splats.opacities)
