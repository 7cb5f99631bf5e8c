"""Views are reproducible, in range, evenly spread, and survive JSON."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.errors import UserError
from gscomplete.views import ViewDistribution
from gscomplete.views.distribution import MAX_ELEVATION_DEG

distributions = st.builds(
    ViewDistribution,
    azimuth_deg=st.floats(-720, 720),
    elevation_deg=st.floats(-90, 90),
    azimuth_range_deg=st.floats(0, 180),
    elevation_range_deg=st.floats(0, 90),
)


@given(distributions, st.integers(0, 2**63), st.integers(0, 2**40), st.integers(0, 50))
@settings(max_examples=60)
def test_samples_depend_only_on_seed_and_step(
    views: ViewDistribution, seed: int, step: int, count: int
) -> None:
    first = views.sample(seed, step, count)
    views.sample(seed + 1, step, 3)
    again = views.sample(seed, step, count + 2)
    np.testing.assert_array_equal(first[0], again[0][:count])
    np.testing.assert_array_equal(first[1], again[1][:count])
    assert np.all(np.abs(first[0] - views.azimuth_deg) <= views.azimuth_range_deg + 1e-9)
    assert np.all(np.abs(first[1]) <= MAX_ELEVATION_DEG)


def test_seeds_and_steps_differ() -> None:
    views = ViewDistribution(10, 20)
    draws = [views.sample(seed, step, 1)[0][0] for seed in range(20) for step in range(20)]
    assert len(set(draws)) == 400


def test_samples_fill_the_ranges_uniformly() -> None:
    views = ViewDistribution(30, 10, 50, 15)
    draws = [views.sample(1, step, 4) for step in range(2000)]
    azimuths = np.concatenate([draw[0] for draw in draws])
    elevations = np.concatenate([draw[1] for draw in draws])
    for values, center, reach in ((azimuths, 30, 50), (elevations, 10, 15)):
        unit = np.sort((values - center + reach) / (2 * reach))
        assert unit[0] >= 0
        assert unit[-1] <= 1
        assert np.abs(unit - np.linspace(0, 1, len(unit))).max() < 0.02  # Kolmogorov distance
    assert abs(np.corrcoef(azimuths, elevations)[0, 1]) < 0.03


@given(distributions, st.integers(1, 64))
@settings(max_examples=40)
def test_low_discrepancy_starts_at_c_and_stays_in_range(
    views: ViewDistribution, count: int
) -> None:
    azimuths, elevations = views.low_discrepancy(count)
    limit = np.clip(views.elevation_deg, -MAX_ELEVATION_DEG, MAX_ELEVATION_DEG)
    assert azimuths[0] == pytest.approx(views.azimuth_deg)
    assert elevations[0] == pytest.approx(limit)
    assert np.all(np.abs(azimuths - views.azimuth_deg) <= views.azimuth_range_deg + 1e-9)
    assert np.all(np.abs(elevations) <= MAX_ELEVATION_DEG)


@pytest.mark.parametrize("elevation_deg", [85.0, 90.0, -90.0])
def test_views_about_a_pole_do_not_share_one_elevation(elevation_deg: float) -> None:
    views = ViewDistribution(0, elevation_deg)
    drawn = np.abs(views.sample(1, 0, 4000)[1])
    unit = np.sort((drawn - (MAX_ELEVATION_DEG - 15)) / 15)
    assert np.abs(unit - np.linspace(0, 1, len(unit))).max() < 0.03  # Kolmogorov distance
    expected = views.radius * torch.from_numpy(views.direction())
    camera = views.input_camera(16)
    torch.testing.assert_close(camera.positions[0].double(), expected, atol=1e-5, rtol=0)
    assert views.eye() == pytest.approx(expected.numpy())


def test_low_discrepancy_is_more_even_than_random() -> None:
    views = ViewDistribution(0, 0, 50, 15)
    count = 64
    cells = [np.histogram2d(*views.low_discrepancy(count), bins=4, range=[[-50, 50], [-15, 15]])[0]]
    cells += [
        np.histogram2d(*views.sample(0, step, count), bins=4, range=[[-50, 50], [-15, 15]])[0]
        for step in range(8)
    ]
    spread = [cell.std() for cell in cells]
    assert spread[0] < 0.6 * np.mean(spread[1:])


def test_cameras_look_at_the_target_from_the_right_side() -> None:
    views = ViewDistribution(0, 0, radius=3.0, target=(1.0, 2.0, 3.0))
    camera = views.input_camera(32)
    torch.testing.assert_close(camera.positions, torch.tensor([[4.0, 2.0, 3.0]]))
    cameras = views.preview_cameras(32)
    target = torch.tensor([1.0, 2.0, 3.0, 1.0])
    seen = cameras.camera_from_world @ target
    torch.testing.assert_close(
        seen[:, :3], torch.tensor([0.0, 0.0, 3.0]).expand(6, 3), atol=1e-5, rtol=0
    )


@pytest.mark.parametrize("elevation_deg", [-20.0, 0.0, 90.0])
def test_rings_begin_with_c_and_turn_anticlockwise(elevation_deg: float) -> None:
    views = ViewDistribution(20.0, elevation_deg, radius=2.0)
    ring = views.ring(6, 16)
    torch.testing.assert_close(ring[0].positions, views.input_camera(16).positions)
    found = torch.rad2deg(torch.atan2(ring.positions[:, 1], ring.positions[:, 0])) % 360
    expected = torch.tensor([20.0, 80.0, 140.0, 200.0, 260.0, 320.0])
    torch.testing.assert_close(found, expected, atol=1e-3, rtol=0)
    assert float(ring.positions[:, 2].std()) < 1e-5


@given(distributions)
@settings(max_examples=30)
def test_json_round_trip(views: ViewDistribution) -> None:
    assert ViewDistribution.from_json(views.to_json(), "object.json") == views


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"version": 2}, ["version", "expected 1", "found 2"]),
        ({"schema": "x"}, ["schema", "found 'x'"]),
        ({"azimuth": 1}, ["unknown field 'azimuth'"]),
        ({"fov_deg": 0}, ["fov_deg", "found 0"]),
        ({"target": [0, 0]}, ["target", "3 values"]),
    ],
)
def test_json_errors_name_the_field(change: dict, words: list[str]) -> None:
    data = ViewDistribution(0, 0).to_json() | change
    with pytest.raises(UserError) as caught:
        ViewDistribution.from_json(data, "object.json")
    for word in ["object.json", *words]:
        assert word in str(caught.value)


def test_json_missing_field_and_wrong_kind() -> None:
    data = ViewDistribution(0, 0).to_json()
    for field in ("schema", "radius"):
        with pytest.raises(UserError, match=f"missing field '{field}'"):
            ViewDistribution.from_json({k: v for k, v in data.items() if k != field}, "f")
    with pytest.raises(UserError, match="expected an object"):
        ViewDistribution.from_json([], "f")


@pytest.mark.parametrize(
    ("field", "value"),
    [("radius", float("nan")), ("radius", 0.0), ("elevation_deg", 91.0), ("fov_deg", 180.0)],
)
def test_values_out_of_range_are_refused(field: str, value: float) -> None:
    values = {"azimuth_deg": 0.0, "elevation_deg": 0.0} | {field: value}
    with pytest.raises(ValueError, match=field):
        ViewDistribution(**values)


def test_measured_views_are_of_v_and_none_of_those_that_runs_fit() -> None:
    views = ViewDistribution(30.0, 10.0)
    fitted, measured = (
        np.stack(angles) for angles in (views.low_discrepancy(11_000), views.measured(64))
    )
    assert np.all(np.abs(measured[0] - 30.0) <= views.azimuth_range_deg)
    assert np.abs(fitted[:, :, None] - measured[:, None]).max(axis=0).min() > 1e-4
    later = views.low_discrepancy(5, 7)
    assert np.array_equal(np.stack(later), np.stack(views.low_discrepancy(12))[:, 7:])


def test_sides_are_c_and_views_of_v_on_either_hand() -> None:
    views = ViewDistribution(30.0, 10.0, azimuth_range_deg=50.0)
    sides = views.sides(32)
    expected = views.cameras((np.array([30.0, 0.0, 60.0]), np.full(3, 10.0)), 32)
    torch.testing.assert_close(sides.camera_from_world, expected.camera_from_world)
    steep = ViewDistribution(0.0, 90.0).sides(32).camera_from_world
    assert bool(steep.isfinite().all())


def test_the_direction_is_towards_the_input_camera() -> None:
    views = ViewDistribution(35.0, -20.0, target=(0.1, -0.4, 0.2))
    place = views.input_camera(8).positions[0].double().numpy() - np.array(views.target)
    assert np.allclose(views.direction(), place / np.linalg.norm(place), atol=1e-6)


@pytest.mark.parametrize("radius", [1.0, 2.2, 5.0])
def test_pictures_have_room_for_what_outgrew_the_frame(radius: float) -> None:
    views = ViewDistribution(20.0, 10.0, radius=radius)
    inside = np.array([[-0.3, -0.3, -0.3], [0.3, 0.2, 0.3]]) * radius
    assert views.to_show(inside) is views
    assert views.to_show(inside[:0]) is views
    many = np.concatenate([np.tile(inside, (2000, 1)), np.full((1, 3), 1e17)])
    assert views.to_show(many) is views  # one stray
    for wild in (1e17, np.inf, np.nan):
        assert views.to_show(np.full((4, 3), wild)) is views
    tall = np.array([[0.0, 0.0, -1.2], [0.1, 0.1, 0.4]]) * radius
    wider = views.to_show(tall)
    assert wider.azimuth_deg == views.azimuth_deg
    assert wider.elevation_deg == views.elevation_deg
    # float64; quantiles of two points lie by the same share inside either
    assert np.allclose(wider.target, tall.mean(axis=0), rtol=0, atol=1e-12)
    ring = wider.ring(4, 64)
    points = torch.nn.functional.pad(torch.from_numpy(tall).float(), (0, 1), value=1.0)
    seen = points @ ring.camera_from_world.transpose(1, 2)
    pixels = seen[..., :2] / seen[..., 2:3] * ring.focal_px[:, None] + ring.center_px[:, None]
    assert float(pixels.min()) > 0
    assert float(pixels.max()) < 64
