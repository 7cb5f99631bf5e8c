"""Cleaning removes planes, outliers and clutter, keeps the object, and counts everything."""

import dataclasses

import numpy as np
import pytest

from gscomplete.errors import UserError
from splatcomplete_data.cuts.boxes import CropBox
from splatcomplete_data.scan.clean import (
    CleanSettings,
    Surroundings,
    clean,
    level_rotation,
    not_outliers,
)
from splatcomplete_data.scan.cloud import PointCloud, grey_colors
from splatcomplete_data.scan.make import PartSettings, make_part
from splatcomplete_data.scan.support import PlaneSettings, find_plane


def scene(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A tilted table, a ball on it, a smaller ball, and a few strays; labels 0 to 3."""
    rng = np.random.default_rng(seed)
    table = np.concatenate([rng.uniform(-1, 1, (6000, 2)), rng.normal(0, 0.002, (6000, 1))], 1)

    def ball(count: int, radius: float, center: list[float]) -> np.ndarray:
        points = rng.normal(size=(count, 3))
        return radius * points / np.linalg.norm(points, axis=1, keepdims=True) + center

    parts = [
        table,
        ball(3000, 0.25, [0, 0, 0.36]),
        ball(600, 0.1, [0.7, 0.6, 0.25]),
        rng.uniform(1.5, 3, (12, 3)),
    ]
    labels = np.repeat(np.arange(4), [len(part) for part in parts])
    angle = 0.5
    turn = np.array(
        [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    )
    return np.concatenate(parts) @ turn.T, labels


def grey(points: np.ndarray) -> PointCloud:
    """Return points without colours."""
    return PointCloud(points, grey_colors(len(points)))


def test_each_step_removes_what_it_is_for() -> None:
    points, labels = scene()
    cleaned = clean(grey(points))
    kept = labels[cleaned.keep]
    assert (kept == 1).mean() > 0.999
    assert (kept == 1).sum() > 2950
    names = np.array([*cleaned.reasons, "kept"])[cleaned.reason]
    assert (names[labels == 0] == "planes").mean() > 0.99
    assert set(names[labels == 3]) <= {"outliers", "clutter"}
    assert (names[labels == 2] == "clutter").mean() > 0.9
    for first, second in zip(cleaned.steps, cleaned.steps[1:], strict=False):
        assert first.after == second.before
    assert cleaned.steps[-1].after == cleaned.keep.sum()
    again = clean(grey(points))
    assert np.array_equal(again.keep, cleaned.keep)


def test_every_step_has_a_switch() -> None:
    points, _ = scene()
    nothing = clean(grey(points), CleanSettings(planes=0, outlier_ratio=None, clusters=0))
    assert nothing.keep.all()
    assert nothing.steps == ()
    seed = tuple(points[9200])
    seeded = clean(grey(points), CleanSettings(seed_point=seed))  # type: ignore[arg-type]
    assert 500 < seeded.keep.sum() < 700
    with pytest.raises(UserError, match="--seed-point: expected a point on an object"):
        clean(grey(points), CleanSettings(seed_point=(0.0, 0.0, 1e3)))


def test_outliers_and_small_clouds() -> None:
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.normal(size=(500, 3)), [[30.0, 0, 0]]])
    kept = not_outliers(points, 16, 3.0)
    assert not kept[-1]
    assert kept[:-1].mean() > 0.97
    assert not_outliers(points[:1], 16, 3.0).all()
    assert find_plane(points[:2], 1.0, PlaneSettings()) is None
    line = np.outer(np.arange(50.0), [1, 1, 1])
    assert find_plane(line, 1e-9, PlaneSettings()) is None


def test_a_cloud_that_is_all_plane_stays_and_that_is_told() -> None:
    points, labels = scene()
    flat = points[labels == 0]
    cleaned = clean(grey(flat[np.abs(flat @ [0, -np.sin(0.5), np.cos(0.5)]) < 0.004]))
    assert cleaned.planes == ()
    assert "none is removed" in cleaned.warnings[-1]


def test_a_box_with_nothing_but_table_is_a_user_error() -> None:
    points, labels = scene()
    table = points[labels == 0]
    wanted = np.linalg.norm(table, axis=1) < 0.1
    with pytest.raises(UserError, match="planes"):
        clean(grey(table), wanted=wanted)


def test_levelling_lifts_the_plane_and_is_recorded() -> None:
    points, labels = scene()
    cloud = PointCloud(points, np.full(points.shape, 0.5, np.float32))
    eye = np.array([0.0, -3.0, 3.0])
    settings = PartSettings(cleaning=CleanSettings(), level="always")
    part = make_part(cloud, settings, "scene", Surroundings(tuple(eye)))
    assert part.turn is not None
    plane = np.array([0.0, -np.sin(0.5), np.cos(0.5), 0.0])
    rotation = level_rotation(plane, eye)
    # four standard errors of a slope fitted to 6000 points of the table's noise
    error = 4 * 0.002 / (6000 / 3) ** 0.5
    np.testing.assert_allclose(part.turn.rotation.numpy(), rotation, rtol=0, atol=error)
    spread = part.splats.means.numpy()
    # heights on a ball are uniform: the outermost of 3000 lie some .5 / 3000 inside
    assert spread[:, 2].min() == pytest.approx(0.11, abs=4 * 0.5 / 3000)
    assert spread[:, 2].max() == pytest.approx(0.61, abs=4 * 0.5 / 3000)
    moved = part.turn.inverse().apply(part.splats.means.double()).numpy()
    kept = points[labels == 1]
    assert np.linalg.norm(moved[:50, None] - kept[None], axis=2).min(axis=1).max() < 1e-5


def test_what_is_chosen_of_a_picture_is_levelled_on_the_table_beside_it() -> None:
    points, labels = scene()
    ball = points[labels == 1]
    up = (0.0, 0.0, 1.0)  # the camera's: the scene leans by .5
    seen = Surroundings((0.0, -3.0, 3.0), up, points, is_picture_up=True)
    part = make_part(grey(ball), PartSettings(), "scene", seen)
    assert part.turn is not None
    level = np.array([0.0, -np.sin(0.5), np.cos(0.5)])
    assert part.turn.rotation.numpy()[2] @ level > np.cos(np.radians(0.5))
    assert len(part.splats) == len(ball)  # nothing is removed for it
    assert "turned by 29 degrees" in part.warnings[-1]

    for settings, known in (
        (PartSettings(level="never"), seen),
        (PartSettings(), dataclasses.replace(seen, is_picture_up=False)),
        (PartSettings(), dataclasses.replace(seen, scene=ball)),
        (PartSettings(), dataclasses.replace(seen, up=(0.0, 0.9, -0.4))),
    ):
        kept = make_part(grey(ball), settings, "scene", known)
        assert kept.turn is None
        is_guessed = known.is_picture_up and settings.level == "auto"
        assert ("no floor or table" in "".join(kept.warnings)) == is_guessed
    line = np.outer(np.linspace(0, 1, 50), [1.0, 1.0, 1.0])
    with pytest.raises(UserError, match="--level: expected a plane"):
        make_part(grey(line), PartSettings(level="always"), "scene")


def test_boxes_thinning_and_their_errors() -> None:
    points, _ = scene()
    cloud = PointCloud(points, np.full(points.shape, 0.5, np.float32))
    part = make_part(cloud, PartSettings(count=1000), "scene")
    assert 900 <= len(part.splats) <= 1000
    assert part.sigma == pytest.approx(float(part.splats.scales[0, 0]))
    box = CropBox((100, 0, 0), (1, 1, 1))
    with pytest.raises(UserError, match=r"scene: --box.*span"):
        make_part(cloud, PartSettings(boxes=(box,)), "scene")
    with pytest.raises(UserError, match="--spacing"):
        make_part(cloud, PartSettings(spacing=-1.0), "scene")


@pytest.mark.parametrize("height", [-5.0, 5.0])
@pytest.mark.parametrize("turned_over", [False, True])
def test_without_a_viewpoint_up_is_where_the_points_that_stay_lie(
    height: float, turned_over: bool
) -> None:
    rng = np.random.default_rng(1)
    floor = np.concatenate([rng.uniform(-1, 1, (4000, 2)), np.zeros((4000, 1))], axis=1)
    post = rng.uniform([-0.1, -0.1, 0.05], [0.1, 0.1, 0.8], (2000, 3))
    points = np.concatenate([floor, post]) * (-1 if turned_over else 1) + [0, 0, height]
    cloud = PointCloud(points, np.full(points.shape, 0.5, np.float32))
    settings = PartSettings(cleaning=CleanSettings(clusters=0), level="always")
    z = make_part(cloud, settings, "scene").splats.means[:, 2]
    ground = -height if turned_over else height
    assert float(z.min()) > ground
    # of 2000 random heights the last ends up to a few spacings inside the end
    assert float(z.max()) == pytest.approx(ground + 0.8, abs=4 * 0.75 / 2000)


@pytest.mark.parametrize("level", [False, True])
def test_georeferenced_points_keep_their_digits(level: bool) -> None:
    points, labels = scene()
    far = np.array([500_000.0, 5_300_000.0, 300.0])
    colors = np.full(points.shape, 0.5, np.float32)
    settings = PartSettings(cleaning=CleanSettings(), level=level)
    eye = np.array([0.0, -3.0, 3.0])
    near = make_part(PointCloud(points, colors), settings, "scene", Surroundings(tuple(eye)))
    part = make_part(
        PointCloud(points + far, colors), settings, "scene", Surroundings(tuple(eye + far))
    )
    assert near.offset is None
    assert near.file_from_source is near.turn
    ball = (points + far)[labels == 1]
    # tenths, as the ball is smaller than a unit; its end splats may be left out as outliers
    middle = (ball.min(axis=0) + ball.max(axis=0)) / 2
    np.testing.assert_allclose(part.offset, middle, rtol=0, atol=0.1 / 2 + 0.005)
    moved = part.file_from_source
    assert moved is not None
    back = moved.inverse().apply(part.splats.means.double()).numpy()
    assert np.linalg.norm(back[:50, None] - ball[None], axis=2).min(axis=1).max() < 1e-6
    assert part.sigma == pytest.approx(near.sigma, rel=1e-6)
    assert len(part.splats) == len(near.splats)
    assert len(part.splats.means.unique(dim=0)) == len(part.splats)


def test_edges_and_corners_of_a_clean_surface_are_no_outliers() -> None:
    """A square of points: about its corners lies a quarter of the neighbours."""
    grid = np.stack(np.meshgrid(*[np.arange(60.0)] * 2), axis=-1).reshape(-1, 2)
    square = np.column_stack([grid, np.zeros(len(grid))])
    with_stray = np.concatenate([square, [[30.0, 30.0, 6.0]]])
    kept = not_outliers(with_stray, 16, 2.5)
    assert kept[:-1].all()
    assert not kept[-1]


@pytest.mark.parametrize("neighbours", [1, 3, 16])
def test_outliers_equal_their_slow_twin(neighbours: int) -> None:
    """Sparse points make the nearest neighbour and the farthest of a few quite different."""
    points = np.random.default_rng(3).lognormal(0, 1, (200, 3))
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    mean = np.sort(apart, axis=1)[:, :neighbours].mean(axis=1)
    expected = mean <= max(mean.mean() + 1.5 * mean.std(), 2 * np.median(mean))
    assert 0 < (~expected).sum() < 40
    assert np.array_equal(not_outliers(points, neighbours, 1.5), expected)
