"""Splats that are probably not of the object: floaters, giants, haze, needles."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.splats import Similarity, Splats, concatenate, transform_splats
from gscomplete.splats.suspects import (
    FEWEST,
    SuspectLimits,
    describe_suspects,
    find_suspects,
    suspect_counts,
    suspect_rows,
)
from tests.completion.oracle import ball


def scattered(count: int, half_side: float, scale: float = 0.004, seed: int = 5) -> Splats:
    generator = torch.Generator().manual_seed(seed)
    return Splats(
        (2 * torch.rand(count, 3, generator=generator) - 1) * half_side,
        torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
        torch.full((count, 3), scale),
        torch.full((count,), 0.9),
        torch.zeros(count, 1, 3),
    )


def odd(base: Splats, count: int, **fields: object) -> Splats:
    """The first splats of a set, changed."""
    some = base.select(torch.arange(count))
    full = {
        name: torch.tensor(value, dtype=torch.float32).expand_as(getattr(some, name)).clone()
        for name, value in fields.items()
    }
    return dataclasses.replace(some, **full)


def slow_floaters(splats: Splats, spacings: float) -> np.ndarray:
    """All distances, no tree and no grid."""
    means = splats.means.double().numpy()
    sizes = splats.scales.amax(dim=1).double().numpy()
    distances = np.linalg.norm(means[:, None] - means[None], axis=-1)
    order = distances.argsort(axis=1, kind="stable")[:, 8]
    eighth = np.take_along_axis(distances, order[:, None], axis=1)[:, 0]
    limit = spacings * np.quantile(eighth[eighth > 0], 0.05)
    return (eighth > limit) & (eighth > 3 * (sizes + sizes[order]))


@pytest.mark.parametrize("share", [0.02, 0.5, 0.9])
def test_floaters_are_found_however_many_there_are(share):
    surface = ball(1000)
    count = round(1000 * share / (1 - share))
    half_side = 3.0 * max(1.0, (count / 1000) ** (1 / 3))
    together = concatenate([surface, scattered(count, half_side)])
    masks = suspect_rows(together)
    assert not masks["floaters"][:1000].any()
    missed = int((~masks["floaters"][1000:]).sum())
    near = int((together.means[1000:].norm(dim=1) < 0.7).sum())  # beside the ball or in it
    assert missed <= near + 1
    assert set(suspect_counts(masks)) == {"floaters"}
    (note,) = describe_suspects(together)
    assert "floaters" in note


def test_every_reason_has_a_mask_of_its_own():
    surface = ball(1000)
    far = odd(surface, 3, means=[2.0, 0.0, 0.0], scales=[0.01, 0.01, 0.01])
    far = dataclasses.replace(far, means=far.means * torch.tensor([[1.0], [2.0], [3.0]]))
    giants = odd(surface, 4, scales=[0.4, 0.3, 0.01])
    haze = odd(surface, 5, scales=[0.1, 0.1, 0.01], opacities=0.05)
    needles = odd(surface, 6, scales=[0.1, 0.001, 0.002])
    masks = suspect_rows(concatenate([surface, far, giants, haze, needles]))
    rows = {name: mask.nonzero().flatten().tolist() for name, mask in masks.items()}
    assert rows == {
        "floaters": [1000, 1001, 1002],
        "giants": [1003, 1004, 1005, 1006],
        "haze": [1007, 1008, 1009, 1010, 1011],
        "needles": [1012, 1013, 1014, 1015, 1016, 1017],
    }


def test_a_sound_surface_has_none_and_says_nothing():
    surface = ball(2000)
    assert suspect_counts(suspect_rows(surface)) == {}
    assert describe_suspects(surface) == ()


def test_a_wall_of_few_large_splats_is_no_crowd_of_floaters():
    """Where splats are sparse because they are large, they still touch."""
    grid = torch.cartesian_prod(torch.linspace(0, 10, 12), torch.linspace(0, 10, 12))
    wall = scattered(144, 1.0, scale=0.6)
    wall = dataclasses.replace(wall, means=torch.cat([grid, torch.zeros(144, 1)], dim=1))
    together = concatenate([ball(1000), wall])
    assert not suspect_rows(together)["floaters"].any()


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    count=st.integers(FEWEST, 300),
    scale=st.sampled_from([1e-4, 0.02, 0.3]),
    power=st.integers(-12, 12),
)
def test_the_fast_floaters_are_the_slow_ones_in_any_frame(seed, count, scale, power):
    generator = torch.Generator().manual_seed(seed)
    splats = scattered(count, 1.0, scale, seed)
    reach = torch.rand(count, 1, generator=generator) ** 4
    splats = dataclasses.replace(splats, means=splats.means * reach * 10)
    expected = slow_floaters(splats, SuspectLimits().floater_spacings)
    assert (suspect_rows(splats)["floaters"].numpy() == expected).all()
    moved = transform_splats(splats, Similarity(2.0**power, torch.eye(3), torch.zeros(3)))
    for name, mask in suspect_rows(splats).items():
        assert torch.equal(suspect_rows(moved)[name], mask)


@pytest.mark.parametrize("case", ["one place", "all but one", "far", "few", "line"])
def test_extremes_have_an_answer(case):
    splats = ball(300)
    means = splats.means.clone()
    if case == "one place":
        means[:] = 1.0
    elif case == "all but one":
        means[1:] = 1.0
    elif case == "far":
        means[:2] = 9e17
    elif case == "line":
        means[:, 1:] = 0
    splats = dataclasses.replace(splats, means=means)
    if case == "few":
        splats = splats.select(torch.arange(FEWEST - 1))
    masks = suspect_rows(splats)
    assert all(mask.shape == (len(splats),) for mask in masks.values())
    assert int(masks["floaters"].sum()) == {"far": 2}.get(case, 0)
    nothing = find_suspects(np.zeros((0, 3), "f4"), np.zeros((0, 3), "f4"), np.zeros(0, "f4"))
    assert not any(mask.any() for mask in nothing.values())
    assert math.isfinite(sum(suspect_counts(masks).values()))
