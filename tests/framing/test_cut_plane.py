import numpy as np
import pytest

from gscomplete.framing.cut_plane import find_cut
from gscomplete.splats.geometry.neighbourhood import flat_axes
from tests.builders.objects import angle_between, ball, half, pipe

BALL = ball().means.double().numpy()


@pytest.mark.parametrize("azimuth_deg", [0.0, 37.0, 200.0])
@pytest.mark.parametrize("offset", [-0.1, 0.1])
def test_the_plane_of_a_cut_is_found(azimuth_deg, offset):
    angle = np.radians(azimuth_deg)
    normal = np.array([np.cos(angle), np.sin(angle), 0.0])
    found = find_cut(1e3 * BALL[BALL @ normal < offset] + [5.0, 3.0, 1e3])
    assert found is not None
    assert abs((found.azimuth_deg - azimuth_deg + 180) % 360 - 180) <= 4.0
    assert found.rim_share > 0.6


def test_closed_surfaces_level_cuts_and_scans_have_no_upright_plane():
    assert find_cut(BALL) is None
    assert find_cut(BALL[BALL[:, 2] < 0.1]) is None
    # Two planes at a right angle: half of the rim lies in each, none holds all but one side.
    corner = BALL[(BALL[:, 0] < 0) | (BALL[:, 1] < 0)]
    assert find_cut(corner) is None


def test_too_few_points_have_none():
    assert find_cut(np.zeros((4, 3))) is None
    assert find_cut(np.zeros((100, 3))) is None


def test_a_cut_through_the_middle_is_one_of_symmetry_and_shows_what_was_cut_away():
    normal = np.array([np.cos(0.6), np.sin(0.6), 0.0])
    kept = 1e3 * BALL[BALL @ normal < 0] + [5.0, 3.0, 1e3]
    found = find_cut(kept)
    assert found is not None
    assert found.is_symmetric
    assert abs(found.offset - np.array([5.0, 3.0, 1e3]) @ normal) < 10.0
    both = np.concatenate([kept, found.mirrored(kept)])
    # The ball is 800 wide; the plane lies up to a spacing off. Measured: 3.5.
    np.testing.assert_allclose(both.mean(axis=0), [5.0, 3.0, 1e3], atol=7.0)


@pytest.mark.parametrize("offset", [-0.15, 0.15])
def test_a_cut_beside_the_middle_is_not_one_of_symmetry(offset):
    found = find_cut(BALL[BALL[:, 0] < offset])
    assert found is not None
    assert not found.is_symmetric


def test_a_surface_runs_into_its_cut_and_a_scans_rim_lies_along_its_plane():
    cut, scan = find_cut(BALL[BALL[:, 0] < 0.15]), find_cut(BALL[BALL[:, 0] > 0.35])
    assert cut is not None
    assert cut.meets_surface
    assert scan is None or not scan.meets_surface


def test_half_a_sheet_ends_in_a_plane_but_is_not_mirrored():
    rng = np.random.default_rng(0)
    sheet = np.stack([rng.random(4000), rng.random(4000), 0.0 * rng.random(4000)], axis=1)
    upright = sheet[:, [0, 2, 1]]
    for points in (upright, upright[upright[:, 0] < 0.5]):
        found = find_cut(points)
        assert found is None or not found.is_symmetric


@pytest.mark.parametrize(("turn_deg", "expected"), [(0.0, True), (35.0, False)])
def test_a_slab_is_mirrored_at_a_cut_across_it_but_not_aslant(turn_deg, expected):
    """Top and bottom meet any upright plane squarely; the sides tell."""
    steps, walls = np.arange(-0.5, 0.501, 0.01), np.arange(-0.05, 0.051, 0.01)
    level = np.stack(np.meshgrid(steps, 0.6 * steps), -1).reshape(-1, 2)
    faces = [np.insert(level, 2, z, axis=1) for z in (-0.06, 0.06)]
    along = np.stack(np.meshgrid(steps, walls), -1).reshape(-1, 2)
    sides = [np.insert(along, 1, y, axis=1) for y in (-0.31, 0.31)]
    across = np.stack(np.meshgrid(0.6 * steps, walls), -1).reshape(-1, 2)
    ends = [np.insert(across, 0, x, axis=1) for x in (-0.51, 0.51)]
    slab = np.concatenate(faces + sides + ends)
    turn = np.radians(turn_deg)
    found = find_cut(slab[slab @ [np.cos(turn), np.sin(turn), 0.0] < 0.0])
    assert found is not None
    assert found.squareness > 0.78
    assert found.is_symmetric == expected
    assert (found.wall_cosine < 0.2) == expected  # measured: .13, .57


def sheets(
    names: tuple[str, ...], size: tuple[float, float, float], step: float = 0.02
) -> tuple[np.ndarray, np.ndarray]:
    """Even points on some faces of a box about the origin, in any order, and their normals."""
    points, axes = [], []
    for sign, letter in names:
        axis = "xyz".index(letter)
        steps = [np.arange(-side / 2, side / 2 + 1e-9, step) for side in size]
        steps[axis] = np.array([float(f"{sign}0.5") * size[axis]])
        points.append(np.stack(np.meshgrid(*steps), -1).reshape(-1, 3))
        axes.append(np.tile(np.eye(3)[axis], (len(points[-1]), 1)))
    order = np.random.default_rng(0).permutation(sum(map(len, points)))
    return np.concatenate(points)[order], np.concatenate(axes)[order]


@pytest.mark.parametrize("is_half", [True, False])
def test_a_complete_tunnel_is_not_mirrored_at_its_end(is_half):
    """Its ends are as square as cuts, but it is symmetric about its own middle."""
    names = ("-y", "+y", "-z", "+z", *["-x"] * is_half)
    cut = find_cut(*sheets(names, (1.0, 0.6, 0.4)))
    assert cut is not None
    assert cut.is_square
    assert cut.is_symmetric == is_half
    assert (cut.own_symmetry > 0.95) == (not is_half)  # measured: .90, 1.0


def discs(
    places: tuple[tuple[float, float, float], ...], radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Level sheets and their normals."""
    points, _ = sheets(("+z",), (2 * radius, 2 * radius, 0.0))
    disc = points[np.hypot(points[:, 0], points[:, 1]) <= radius]
    together = np.concatenate([disc + place for place in places])
    return together, np.tile([0.0, 0.0, 1.0], (len(together), 1))


def joined(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    points, axes = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = np.random.default_rng(0).permutation(len(points))
    return points[order], axes[order]


def test_rims_of_other_sheets_do_not_hide_a_square_cut():
    """Half a bench with cushions, most of whose rim is theirs."""
    bench = sheets(("-x", "-y", "+y", "-z", "+z"), (1.0, 0.6, 0.4))
    cushions = discs(tuple((x, 0.0, 0.35) for x in (-0.3, 0.1)), 0.2)
    cut = find_cut(*joined(bench, cushions))
    assert cut is not None
    assert cut.rim_share < 0.35  # measured: .31
    assert cut.is_symmetric


def test_of_a_flat_thing_most_rims_are_no_cuts():
    points, axes = discs(((0.0, 0.0, 0.0),), 0.5)
    kept = points[:, 0] <= 0.0
    on_it = discs(((-0.25, -0.2, 0.05), (-0.25, 0.2, 0.05)), 0.17)
    cut = find_cut(*joined((points[kept], axes[kept]), on_it))
    assert cut is not None
    assert 0.25 <= cut.rim_share < 0.35
    assert cut.squareness > 0.9
    assert not cut.is_symmetric


def test_flat_splats_tell_how_a_thin_wall_meets_its_cut():
    kept = half(pipe())
    assert find_cut(kept.means.double().numpy()) is None
    found = find_cut(kept.means.double().numpy(), flat_axes(kept))
    assert found is not None
    assert angle_between(found.azimuth_deg, 180.0) < 2.0
    assert abs(found.offset) < 0.02  # splats are about .03 apart
    assert found.squareness > 0.9  # measured: 1.0
