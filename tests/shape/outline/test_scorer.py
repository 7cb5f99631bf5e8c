import numpy as np
import pytest

from gscomplete.shape.outline import scorer
from gscomplete.shape.outline.scorer import (
    FEATURES,
    MOST_LOGITS,
    OF_VIEW,
    doubts_beside_outlines,
    outline_features,
    packaged_outline_scorer,
)
from gscomplete.shape.outline.views import AZIMUTHS, ELEVATIONS_DEG, SIDE_PX, views_at
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball
from tests.builders.threads import each_thread_count

VIEWS = ViewDistribution(0.0, 10.0)
BALL = ball(6000).means.numpy()  # radius 0.4
RING = (len(ELEVATIONS_DEG), AZIMUTHS)


def column(features, name):
    return features[:, FEATURES.index(name)].reshape(RING)


def figure() -> np.ndarray:
    """Return points of a head on a body on two legs that stand apart along y."""
    rng = np.random.default_rng(0)
    parts = []
    for center, radii, count in (
        ((0, 0, 0.32), (0.12, 0.12, 0.14), 3000),
        ((0, 0, 0), (0.16, 0.2, 0.24), 6000),
        ((0, 0.15, -0.3), (0.06, 0.06, 0.2), 2500),
        ((0, -0.15, -0.3), (0.06, 0.06, 0.2), 2500),
    ):
        way = rng.normal(size=(count, 3))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        parts.append(np.array(center) + way * radii)
    return np.concatenate(parts).astype(np.float32)


def scanned(points, azimuths_deg, distance=2.2):
    """Return what scanners at the height of the points see of them."""
    seen = np.zeros(len(points), bool)
    for azimuth in np.radians(azimuths_deg):
        axes = views_at(distance)[0].axes
        turn = np.array(
            [
                [np.cos(azimuth), np.sin(azimuth), 0],
                [-np.sin(azimuth), np.cos(azimuth), 0],
                [0, 0, 1],
            ]
        )
        view = type(views_at(distance)[0])((axes @ turn).astype(np.float32), distance)
        pixel, depth = view.pixels(points)
        nearest = np.full(pixel.max() + 1, np.inf)
        np.minimum.at(nearest, pixel, depth)
        seen |= depth < nearest[pixel] + 0.03
    return points[seen]


def test_a_closed_ball_is_alike_from_all_sides():
    features = outline_features(BALL, VIEWS, ends_in_plane=False)
    assert features.shape == (RING[0] * RING[1], len(FEATURES))
    assert np.isfinite(features).all()
    for name in OF_VIEW:
        values = column(features, name)
        assert np.ptp(values) < 0.06, name  # points lie at random
    seen = column(features, "seen")
    assert 0.2 < seen.min() <= seen.max() < 0.5  # of what faces the viewer, all but the steepest
    assert column(features, "seen_through").max() < 0.02
    assert column(features, "edge_rim").max() < 0.02
    assert column(features, "edge_cosine").max() < column(features, "cosine").min() - 0.1


def test_what_half_a_ball_shows_tells_its_open_side():
    half = BALL[BALL[:, 0] > 0]  # open to -x; level views from +x come first
    features = outline_features(half, VIEWS, ends_in_plane=True)
    level = {name: column(features, name)[0] for name in FEATURES}
    front, side, back = 0, AZIMUTHS // 4, AZIMUTHS // 2
    assert level["seen"][front] > 1.8 * level["seen"][side]
    assert level["seen_through"][front] > 0.3
    assert level["seen_through"][side] < 0.02
    assert level["edge_rim_facing"][side] > 0.1
    assert level["edge_rim_facing"][front] < 0.02
    assert level["area"][side] < 0.75 < level["area"][front]
    assert level["seen_opposite"] == pytest.approx(np.roll(level["seen"], AZIMUTHS // 2))
    assert level["seen_lesser_6"][front] == pytest.approx(min(level["seen"][[6, -6]]))
    assert level["seen_greater_1"][3] == pytest.approx(max(level["seen"][[2, 4]]))
    assert level["seen_most"] == pytest.approx(features[:, 0].max())
    assert level["cosine_to_c"][[front, back]] == pytest.approx([1.0, -1.0])
    assert (level["ends_in_plane"] == 1).all()
    assert (level["seen_within_90"] >= level["seen_within_45"]).all()
    assert (level["seen_within_45"] >= level["seen"]).all()


def test_place_and_distance_are_those_of_the_views():
    moved = ViewDistribution(0.0, 10.0, target=(0.25, -0.5, 0.125))
    shift = np.array(moved.target, np.float32)
    part = BALL[BALL[:, 0] > 0.05]
    here = outline_features(part, VIEWS, ends_in_plane=False)
    there = outline_features(part + shift, moved, ends_in_plane=False)
    assert there == pytest.approx(here, abs=0.02)  # points beside a limit fall either way


@pytest.mark.parametrize("count", [0, 1, 24])
def test_of_next_to_nothing_no_outline_is_whole(count):
    points = BALL[:count]
    assert not outline_features(points, VIEWS, ends_in_plane=False).any()
    assert not doubts_beside_outlines(points, VIEWS, BALL, ends_in_plane=False).any()


def level_scores(part):
    """Return the scores of level views, from +x on."""
    features = outline_features(part, VIEWS, ends_in_plane=False)
    return packaged_outline_scorer()(features).reshape(RING)[0]


def test_from_where_a_figure_was_scanned_its_outline_is_whole():
    part = scanned(figure(), (-30, 0, 30))
    between_legs, beside_head, behind = (0.0, 0.0, -0.4), (0.0, 0.3, 0.35), (-0.1, 0.0, 0.0)
    asked = np.array([between_legs, beside_head, behind], np.float32)
    found = doubts_beside_outlines(part, VIEWS, asked, ends_in_plane=False)
    assert (found[:2] > MOST_LOGITS / 2).all()
    assert found[2] == 0
    assert level_scores(part)[[-1, 0, 1]].min() > 3


def test_beside_the_scanner_an_outline_lacks_what_turns_away():
    scores = level_scores(scanned(figure(), (0,)))
    assert scores[[-1, 0, 1]].min() > 1
    assert scores[[AZIMUTHS // 4, -AZIMUTHS // 4]].max() < -3


def test_of_half_a_figure_the_other_half_is_hardly_doubted():
    whole = figure()
    half = whole[whole[:, 1] > 0]
    lost = whole[whole[:, 1] < -0.05]
    assert doubts_beside_outlines(half, VIEWS, lost, ends_in_plane=True).max() < 1


@pytest.mark.parametrize("captured", [False, True])
def test_the_surest_outline_that_leaves_a_place_out_counts(monkeypatch, captured):
    grid = views_at(VIEWS.radius)
    sure = {0: 9.0, 30: 2.5, 55: 3.0}  # log odds; of all others it is unlikely
    scores = np.array([sure.get(k, -1.0) for k in range(len(grid))])

    def packaged(*, of_captures):
        assert of_captures == captured
        return lambda features: scores

    monkeypatch.setattr(scorer, "packaged_outline_scorer", packaged)
    asked = np.random.default_rng(1).uniform(-0.7, 0.7, (500, 3)).astype(np.float32)
    part = BALL[BALL[:, 0] > 0]
    target = np.array(VIEWS.target, np.float32)
    lost = {0: MOST_LOGITS, 30: 1.5, 55: 3.0}
    beside = {k: grid[k].beside(part - target, asked - target, SIDE_PX, 7) for k in sure}
    expected = [max(lost[k] * bool(beside[k][n]) for k in sure) for n in range(500)]
    found = doubts_beside_outlines(part, VIEWS, asked, ends_in_plane=False, captured=captured)
    assert found.tolist() == expected
    assert set(expected) == {0.0, 1.5, 3.0, 6.0}


def fuzzy(points: np.ndarray) -> np.ndarray:
    """Move points as training from photos does."""
    return points + np.random.default_rng(2).normal(0, 0.012, points.shape).astype(np.float32)


def test_more_outlines_of_a_capture_are_whole():
    part = fuzzy(scanned(figure(), (-40, -20, 0, 20, 40)))
    features = outline_features(part, VIEWS, ends_in_plane=False)
    plain, of_captures = (packaged_outline_scorer(of_captures=c)(features) for c in (False, True))
    from_there = [k % AZIMUTHS for k in (-2, -1, 0, 1, 2)]
    assert of_captures[from_there].mean() > plain[from_there].mean()


def test_scores_do_not_depend_on_threads():
    part = scanned(figure(), (-30, 0, 30))
    found = []
    for _ in each_thread_count():
        features = outline_features(part, VIEWS, ends_in_plane=False)
        found.append(packaged_outline_scorer()(features).tobytes())
    assert len(set(found)) == 1
