"""Alignment finds known similarities of a part and a complete object."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gscomplete.errors import UserError
from gscomplete.evaluate.align import AlignmentSettings, align_points, align_splats
from gscomplete.evaluate.align.align import diameter, evenly_spread
from gscomplete.evaluate.align.nearest_grid import CELLS, REACH, nearest_grid
from gscomplete.evaluate.align.search import _kth_smallest, even_rotations
from gscomplete.splats.transform import Similarity, transform_splats
from tests.builders.objects import round_splats

FEWER = AlignmentSettings(rotations=300)


def letter(count: int, seed: int) -> np.ndarray:
    """Points on the boxes of a chair-like shape without any symmetry."""
    rng = np.random.default_rng(seed)
    boxes = [((0, 0, 0), (1, 0.8, 0.12)), ((0, 0, 0), (0.12, 0.8, 1.2)),
             ((0.8, 0, 0), (1, 0.2, 0.6)), ((0.3, 0.6, 0.1), (0.6, 1.1, 0.3))]  # fmt: skip
    parts = []
    for low, high in boxes:
        low, high = np.array(low), np.array(high)
        points = low + rng.random((count, 3)) * (high - low)
        axis = rng.integers(3, size=count)
        rows = np.arange(count)
        points[rows, axis] = np.where(rng.random(count) < 0.5, low[axis], high[axis])
        parts.append(points)
    return np.concatenate(parts)


def similarity(seed: int) -> Similarity:
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=seed).as_matrix()
    scale, shift = float(np.exp(rng.uniform(np.log(0.3), np.log(3)))), rng.normal(size=3) * 2
    return Similarity(scale, torch.from_numpy(rotation), torch.from_numpy(shift))


def errors(found: Similarity, true: Similarity) -> tuple[float, float, float]:
    """Degrees, relative scale, and shift of the object's middle, of the residual similarity."""
    left = found.compose(true)
    cosine = float((torch.trace(left.rotation) - 1) / 2)
    middle = torch.tensor([0.4, 0.4, 0.4], dtype=torch.float64)
    shift = float((left.apply(middle) - middle).norm())
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))), abs(left.scale - 1), shift


@pytest.mark.parametrize(("seed", "share"), [(1, 0.64), (2, 0.34)])
def test_a_part_is_found_in_another_sampling_of_the_complete_object(seed, share):
    part = letter(2500, 10)
    reach = part @ np.array([0.6, 0.5, 0.3])
    part = part[reach < np.quantile(reach, share)]
    true = similarity(seed)
    result = true.apply(torch.from_numpy(letter(2500, 20))).numpy()
    found = align_points(result, part, FEWER)
    degrees, scale, shift = errors(found.target_from_result, true)
    assert (degrees < 2, scale < 0.01, shift < 0.01) == (True, True, True)
    assert found.residual < 0.02
    assert found.warning() == ""


def test_the_order_of_points_changes_next_to_nothing():
    part, whole = letter(800, 10), letter(800, 20)
    part = part[part[:, 0] < 0.7]
    rng = np.random.default_rng(0)
    one = align_points(whole, part, FEWER).target_from_result
    two = align_points(rng.permutation(whole), rng.permutation(part), FEWER).target_from_result
    degrees, scale, shift = errors(
        one.compose(two.inverse()), similarity(0).inverse().compose(similarity(0))
    )
    assert (degrees < 1.5, scale < 0.01, shift < 0.01) == (True, True, True)


def test_colours_decide_between_poses_that_the_shape_allows():
    """A box with one red end: its shape alone allows four poses."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (6000, 3))
    axis, rows = rng.integers(3, size=6000), np.arange(6000)
    points[rows, axis] = np.sign(points[rows, axis]) * 0.5
    points *= [1.0, 0.6, 0.35]
    colors = np.where(points[:, :1] > 0.2, [[0.8, 0.1, 0.1]], [[0.3, 0.3, 0.3]])
    true = similarity(3)
    light = torch.from_numpy(colors).float()
    box, darker = (round_splats(points, scale=0.01, color=c) for c in (light, 0.6 * light))
    part = box.select(box.means[:, 1] + 0.3 * box.means[:, 2] > -0.1)
    found = align_splats(transform_splats(darker, true), part, FEWER)
    placed = found.target_from_result.compose(true).apply(box.means)
    red = box.base_colors[:, 0] > 0.5
    assert float((placed[red, 0] > 0.15).float().mean()) > 0.97  # the red end is at the red end
    assert found.runner_up is not None
    assert found.runner_up > 1.2


def test_rotations_are_proper_and_leave_no_gap():
    rotations = even_rotations(1000)
    unit = np.einsum("nij,nkj->nik", rotations, rotations)
    assert np.abs(unit - np.eye(3)).max() < 1e-12
    assert np.abs(np.linalg.det(rotations) - 1).max() < 1e-12
    asked = Rotation.random(200, random_state=0).as_matrix()
    cosine = (np.einsum("aij,nij->an", asked, rotations).max(axis=1) - 1) / 2
    assert np.degrees(np.arccos(cosine)).max() < 20


@given(
    st.lists(
        st.sampled_from([0.0, 0.5, 0.5 + 1e-16, 1.0, 3.0, np.inf]) | st.floats(0, 1e9), min_size=1
    ),
    st.data(),
)
def test_a_value_is_selected_by_its_rank(values, data):
    k = data.draw(st.integers(0, len(values) - 1))
    assert _kth_smallest(np.array(values), k) == np.partition(values, k)[k]


def test_a_look_up_errs_by_about_a_cell():
    rng = np.random.default_rng(0)
    cloud, places = rng.uniform(-0.5, 0.5, (400, 3)), rng.uniform(-0.7, 0.7, (300, 3))
    grid = nearest_grid(cloud)
    cell = np.floor((places + REACH) / (2 * REACH) * CELLS).astype(int)
    found = np.linalg.norm(places - grid.points[grid.index[tuple(cell.T)]], axis=1)
    true = np.linalg.norm(places[:, None] - cloud[None], axis=2).min(axis=1)
    assert (found - true).max() < 2 * 3**0.5 * 2 * REACH / CELLS  # diagonals of a cell


def test_points_are_thinned_to_an_even_density():
    rng = np.random.default_rng(0)
    crowded = np.concatenate(
        [rng.random((9000, 3)) * [0.1, 1, 0], rng.random((1000, 3)) * [1, 1, 0]]
    )
    chosen = crowded[evenly_spread(crowded, 400, rng)]
    assert 300 <= len(chosen) <= 400
    assert (chosen[:, 0] < 0.1).mean() < 0.25  # a tenth of the area, nine tenths of the points


def test_diameters():
    assert diameter(np.eye(3)) == pytest.approx(2**0.5)


def test_too_little_is_refused():
    with pytest.raises(UserError, match="at least 50 finite points, found 3"):
        align_points(np.eye(3), np.eye(3))
    with pytest.raises(UserError, match="found them in one place"):
        align_points(np.zeros((99, 3)), np.zeros((99, 3)))
