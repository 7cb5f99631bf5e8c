"""Rings of views and the memory of their targets."""

import pytest
import torch

from gscomplete.completion.rings import Ring, RingMemory, inside_distribution, random_ring
from gscomplete.priors.base import PriorViews
from gscomplete.views import ViewDistribution, four_view_orbit, radius_to_fit

VIEWS = PriorViews(40.0, (1.3, 1.6), (5.0, 30.0), 32)


def ring(step: int, size_px: int = 8) -> Ring:
    g = torch.Generator().manual_seed(step)
    cameras = four_view_orbit(10.0 * step, 0.0, radius=2.0, fov_deg=40.0, size_px=size_px)
    color = torch.rand(4, size_px, size_px, 3, generator=g)
    return Ring(cameras, color, torch.rand(4, size_px, size_px, generator=g), step)


def test_the_oldest_ring_is_forgotten():
    memory = RingMemory(2)
    assert memory.newest_step is None
    for step in (0, 5, 9):
        memory.add(ring(step))
    assert [memory[k].step for k in range(len(memory))] == [5, 9]
    assert memory.newest_step == 9


def test_a_memory_is_restored_as_it_was():
    memory, again = RingMemory(3), RingMemory(3)
    for step in (1, 2):
        memory.add(ring(step))
    again.restore(memory.tensors)
    assert len(again) == 2
    for k in range(2):
        assert again[k].step == memory[k].step
        assert torch.equal(again[k].color, memory[k].color)
        assert torch.equal(again[k].alpha, memory[k].alpha)
        for name in ("camera_from_world", "focal_px", "center_px"):
            assert torch.equal(getattr(again[k].cameras, name), getattr(memory[k].cameras, name))


@pytest.mark.parametrize("name", ["step", "alpha", "focal_px"])
def test_a_ring_that_lacks_something_is_refused(name):
    memory = RingMemory(3)
    memory.add(ring(1))
    state = memory.tensors
    del state[f"ring.0.{name}"]
    with pytest.raises(ValueError, match=rf"ring\.0\.{name}: expected"):
        memory.restore(state)


def test_targets_keep_their_mean_at_another_size():
    full = ring(1)
    assert full.resized(8)[0] is full.color
    color, alpha = full.resized(4)
    assert color.shape == (4, 4, 4, 3)
    # Antialiased: weights of the borders differ, so the means are only nearly equal.
    assert torch.allclose(color.mean(dim=(1, 2)), full.color.mean(dim=(1, 2)), atol=0.06)
    assert torch.allclose(alpha.mean(dim=(1, 2)), full.alpha.mean(dim=(1, 2)), atol=0.06)


def test_rings_stand_where_the_prior_has_seen_objects():
    elevations, radii, azimuths = [], [], []
    for step in range(60):
        position = random_ring(VIEWS, 16, 0, step).positions[0].double()
        radii.append(float(position.norm()))
        elevations.append(float(torch.rad2deg(torch.asin(position[2] / position.norm()))))
        azimuths.append(float(torch.rad2deg(torch.atan2(position[1], position[0]))))
    low, high = (radius_to_fit(extent, VIEWS.fov_deg) for extent in VIEWS.extent_range)
    assert low - 1e-6 <= min(radii) < max(radii) <= high + 1e-6
    assert max(radii) - min(radii) > 0.8 * (high - low)
    assert 5.0 - 1e-4 <= min(elevations) < 8.0
    assert 27.0 < max(elevations) <= 30.0 + 1e-4
    assert max(azimuths) - min(azimuths) > 300.0


def test_views_of_v_are_told_across_the_end_of_the_circle():
    around = ViewDistribution(175.0, 0.0, azimuth_range_deg=30.0)
    cameras = four_view_orbit(-160.0, 10.0, radius=2.0, fov_deg=40.0, size_px=8)
    assert inside_distribution(cameras, around).tolist() == [True, False, False, False]


def test_a_ring_far_below_v_is_not_trusted():
    from_above = ViewDistribution(0.0, 70.0, azimuth_range_deg=180.0, elevation_range_deg=10.0)
    level, steep = (
        four_view_orbit(0.0, elevation_deg, radius=2.0, fov_deg=40.0, size_px=8)
        for elevation_deg in (0.0, 45.0)
    )
    assert not bool(inside_distribution(level, from_above).any())
    assert bool(inside_distribution(steep, from_above).all())
