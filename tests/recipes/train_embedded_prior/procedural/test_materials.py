from typing import get_args

import numpy as np
import pytest

from recipes.train_embedded_prior.procedural.materials import (
    BakedLight,
    Mark,
    MarkShape,
    Material,
    Pattern,
    bake,
    paint,
    sample_light,
)
from recipes.train_embedded_prior.procedural.palette import (
    ANY,
    COLORS,
    SUBSTANCES,
    pick_color,
    sample_color,
)
from recipes.train_embedded_prior.procedural.primitives import box, cylinder
from recipes.train_embedded_prior.procedural.sampling import sample_quads

RED = np.array([0.8, 0.1, 0.1], np.float32)
BLUE = np.array([0.1, 0.1, 0.8], np.float32)
TUBE = sample_quads([cylinder(0.4, 1.0)], 3000, np.random.default_rng(0))
CUBE = sample_quads([box((1, 1, 1))], 3000, np.random.default_rng(0))


@pytest.mark.parametrize("pattern", get_args(Pattern))
def test_patterns_mix_two_colors_and_show_both(pattern):
    colors = paint(Material(RED, BLUE, pattern, frequency=4.0, phase=0.3), TUBE)
    share = (colors - RED) @ (BLUE - RED) / ((BLUE - RED) @ (BLUE - RED))
    assert np.isfinite(colors).all()
    assert share.min() >= -1e-5
    assert share.max() <= 1 + 1e-5
    if pattern == "solid":
        assert np.array_equal(colors, np.broadcast_to(RED, colors.shape))
    else:
        assert share.min() < 0.3
        assert share.max() > 0.7


def test_stripes_close_around_a_cylinder():
    near = np.abs(np.arctan2(TUBE.points[:, 1], TUBE.points[:, 0])) < 0.05
    side = near & (np.abs(TUBE.normals[:, 2]) < 0.5)
    uv = TUBE.uv[side, 0] * 4.0 % 1.0
    assert ((uv < 0.12) | (uv > 0.88)).all()  # phase 0 on both sides of the seam


def test_marks_paint_only_the_side_they_face():
    mark = Mark((0.5, 0, 0.5), (1, 0, 0), (0.2, 0.3), BLUE, "rectangle")
    colors = paint(Material(RED, marks=(mark,)), CUBE)
    painted = np.isclose(colors, BLUE).all(axis=1)
    inside = (CUBE.normals[:, 0] > 0.9) & (np.abs(CUBE.points[:, 1]) < 0.2)
    inside &= np.abs(CUBE.points[:, 2] - 0.5) < 0.3
    assert np.array_equal(painted, inside)


@pytest.mark.parametrize("shape", get_args(MarkShape))
def test_every_mark_changes_something_near_its_center(shape):
    mark = Mark((0.5, 0, 0.5), (1, 0, 0), (0.3, 0.3), BLUE, shape)
    changed = (paint(Material(RED, marks=(mark,)), CUBE) != RED).any(axis=1)
    assert 10 < changed.sum() < 1000
    assert np.linalg.norm(CUBE.points[changed] - [0.5, 0, 0.5], axis=1).max() < 0.45


def test_light_darkens_what_turns_away_and_stays_in_range():
    light = BakedLight(np.array([0, 0, 1], np.float32), 0.5, 0.3, 0.3)
    white = np.full((len(CUBE.points), 3), 0.8, np.float32)
    lit = bake(light, CUBE, white)
    top, bottom = CUBE.normals[:, 2] > 0.9, CUBE.normals[:, 2] < -0.9
    assert lit[top].mean() > lit[bottom].mean() + 0.3
    assert lit.min() >= 0
    assert lit.max() <= 1
    none = BakedLight(light.direction, 0.0, 0.0, 0.0)
    assert np.array_equal(bake(none, CUBE, white), white)


def test_lights_come_from_above():
    for seed in range(50):
        light = sample_light(np.random.default_rng(seed))
        assert light.direction[2] > 0
        assert np.linalg.norm(light.direction) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("name", COLORS)
def test_named_colors_stay_near_their_center(name):
    rng = np.random.default_rng(1)
    drawn = np.stack([sample_color(name, rng) for _ in range(50)])
    assert np.abs(drawn - COLORS[name].center).max() <= COLORS[name].spread + 1e-6
    assert drawn.min() >= 0.01 - 1e-6
    assert drawn.max() <= 0.99 + 1e-6


def test_color_words_mean_what_they_say():
    centers = np.array([color.center for color in COLORS.values()])
    rng = np.random.default_rng(2)
    for k, name in enumerate(COLORS):
        drawn = np.stack([sample_color(name, rng) for _ in range(40)])
        nearest = np.linalg.norm(drawn[:, None] - centers[None], axis=2).argmin(axis=1)
        assert (nearest == k).mean() > 0.6, name


def test_substances_use_named_colors_and_picks_avoid():
    for options in SUBSTANCES.values():
        assert set(options) <= set(COLORS)
    rng = np.random.default_rng(3)
    assert "red" not in {pick_color(rng, ANY, ("red",)) for _ in range(300)}
    assert pick_color(rng, ("red",), ("red",)) == "red"
