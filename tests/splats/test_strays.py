"""Splats that float beside an object's surface."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.splats import Similarity, Splats, concatenate, transform_splats
from gscomplete.splats import strays as strays_module
from gscomplete.splats.strays import FEATURES, standing_out, stray_rows
from tests.builders.objects import ball, half


def flying(base: Splats, count: int, away: float = 0.2, seed: int = 3) -> Splats:
    """Splats of a set, moved in all directions."""
    generator = torch.Generator().manual_seed(seed)
    some = base.select(torch.randint(len(base), (count,), generator=generator))
    return dataclasses.replace(
        some, means=some.means + away * torch.randn(count, 3, generator=generator)
    )


def hazy(base: Splats, count: int, seed: int = 4) -> Splats:
    haze = flying(base, count, 0.05, seed)
    return dataclasses.replace(
        haze,
        scales=torch.full_like(haze.scales, 0.03),
        opacities=torch.full_like(haze.opacities, 0.06),
    )


@pytest.mark.parametrize("whole", [ball(6000), half(ball(6000))], ids=["ball", "half"])
def test_a_sound_surface_has_none(whole):
    assert not stray_rows(whole).any()
    thinned = whole.select(torch.arange(0, len(whole), 7))
    assert not stray_rows(thinned).any()


@pytest.mark.parametrize("count", [20, 300])
def test_flying_points_are_found_and_surface_is_not(count):
    surface = ball(6000)
    strays = flying(surface, count)
    found = stray_rows(concatenate([surface, strays]))
    assert not found[:6000].any()
    off = (strays.means.norm(dim=1) - surface.means.norm(dim=1).median()).abs() > 0.04
    assert float(found[6000:][off].float().mean()) > 0.9


def test_haze_is_found():
    surface = ball(6000)
    found = stray_rows(concatenate([surface, hazy(surface, 400)]))
    assert not found[:6000].any()
    assert float(found[6000:].float().mean()) > 0.9


def test_a_thin_rod_beside_the_surface_is_none():
    """Its splats are as far apart as others; only there are few of them."""
    surface = ball(6000)
    count = 150
    rod = surface.select(torch.arange(count))
    along = torch.linspace(0, 0.6, count)[:, None] * torch.tensor([[0.0, 0.0, 1.0]])
    ring = torch.arange(count) * 2.4
    around = 0.01 * torch.stack([ring.cos(), ring.sin(), torch.zeros(count)], dim=1)
    start = surface.means.norm(dim=1).median() * torch.tensor([[0.0, 0.0, 1.0]])
    rod = dataclasses.replace(rod, means=start + along + around)
    assert float(stray_rows(concatenate([surface, rod]))[6000:].float().mean()) < 0.05


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**31), power=st.integers(-8, 8), turn=st.floats(-3.0, 3.0))
def test_neither_frame_nor_unit_matter(seed, power, turn):
    """But for rounding, which moves scores by far less than strays are from the limit."""
    surface = ball(1500)
    together = concatenate([surface, flying(surface, 60, seed=seed), hazy(surface, 60, seed)])
    c, s = math.cos(turn), math.sin(turn)
    rotation = torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    moved = transform_splats(
        together, Similarity(2.0**power, rotation, torch.tensor([0.3, -0.1, 2.0]) * 2.0**power)
    )
    here, there = standing_out(together), standing_out(moved)
    both, first, second = np.intersect1d(here.rows, there.rows, return_indices=True)
    assert len(both) >= 0.99 * max(len(here.rows), len(there.rows))
    # At equal distances another neighbour may come first.
    gap = np.abs(here.features[first] - there.features[second])
    assert np.quantile(gap, 0.95) < 1e-2
    assert (stray_rows(together) != stray_rows(moved)).float().mean() < 0.005


def test_features_are_those_of_all_distances():
    """No tree: all distances, sorted, in float64."""
    surface = ball(400)
    splats = concatenate([surface, flying(surface, 40)])
    found = standing_out(splats)
    points = splats.means.double().numpy()
    distances = np.sort(np.linalg.norm(points[:, None] - points[None], axis=2), axis=1)
    order = np.argsort(np.linalg.norm(points[:, None] - points[None], axis=2), axis=1)
    eighth = distances[:, 8]
    expected = {
        f"distance_{rank}": np.log(distances[:, rank] / np.median(eighth))
        for rank in (1, 2, 4, 8, 16, 32)
    }
    for rank in (4, 8, 16):
        others = np.median(distances[:, rank][order[:, 1:17]], axis=1)
        expected[f"outlying_{rank}"] = np.log(distances[:, rank] / others)
    expected["sparse"] = np.log(eighth / np.quantile(eighth, 0.05))
    for name, values in expected.items():
        column = found.features[:, FEATURES.index(name)]
        # Positions and features are float32, whose rounding these logarithms share.
        np.testing.assert_allclose(column, values[found.rows], atol=1e-5)
    sparse = set(np.flatnonzero(eighth > 1.5 * np.median(eighth)))
    assert sparse <= set(found.rows)


@pytest.mark.parametrize("case", ["few", "one place", "line", "huge", "none"])
def test_extremes_have_an_answer(case):
    splats = ball(300)
    means = splats.means.clone()
    if case == "few":
        splats, means = splats.select(torch.arange(150)), means[:150]
    elif case == "one place":
        means[:] = 1.0
    elif case == "line":
        means[:, 1:] = 0
    elif case == "huge":
        means[:2] = 9e17
    elif case == "none":
        splats, means = splats.select(torch.arange(0)), means[:0]
    found = stray_rows(dataclasses.replace(splats, means=means))
    assert found.shape == (len(means),)
    if case == "huge":
        assert found[:2].all()
    elif case in ("few", "one place", "none"):
        assert not found.any()


def test_next_to_none_are_left_to_be_surface():
    surface = ball(6000)
    counts = [
        int(stray_rows(concatenate([surface, flying(surface, n, away=0.4)])).sum()) for n in (3, 60)
    ]
    assert counts[0] == 0
    assert counts[1] > 40


@pytest.mark.parametrize(("share", "is_left"), [(0.4, False), (0.6, True)])
def test_a_set_does_not_consist_of_strays(share, is_left, monkeypatch):
    count = round(1000 * share)
    found = strays_module.StandingOut(np.arange(count), np.zeros((count, len(FEATURES)), "f4"))
    monkeypatch.setattr(strays_module, "standing_out", lambda splats: found)
    scorer = lambda features: np.full(len(features), 5.0)  # noqa: E731
    monkeypatch.setattr(strays_module, "packaged_stray_scorer", lambda: scorer)
    assert int(stray_rows(ball(1000)).sum()) == (0 if is_left else count)
