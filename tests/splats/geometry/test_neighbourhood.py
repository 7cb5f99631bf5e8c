"""Neighbours of a point tell its surface's normal, and whether it ends there."""

from __future__ import annotations

import numpy as np
import pytest

from gscomplete.splats.geometry.neighbourhood import ON_RIM, normals_of, one_sidedness


@pytest.mark.parametrize("normal", [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [-0.48, 0.64, 0.6]])
def test_the_normal_of_a_plane_is_found_wherever_it_lies(normal: list[float]) -> None:
    rng = np.random.default_rng(0)
    across = np.array(normal)
    flat = rng.normal(size=(5, 16, 3))
    flat -= (flat @ across)[..., None] * across
    found = normals_of(flat + np.array([100.0, -3.0, 7.0]))
    # offsets from a place 100 away are rounded to 1e-14
    assert np.abs(found @ across) == pytest.approx(np.ones(5), abs=1e-10)
    assert np.linalg.norm(found, axis=1) == pytest.approx(np.ones(5))


def test_a_rim_has_its_neighbours_to_one_side() -> None:
    angle = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    around = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    inside, rim = one_sidedness(np.stack([around, np.abs(around) * [1, -1, 1]]))
    assert inside < 1e-9
    assert rim > ON_RIM
    assert one_sidedness(np.zeros((2, 0, 3))).tolist() == [0.0, 0.0]
