"""Which way splats face: cameras, pixels, votes the slow way; sheets, round and hidden splats."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from gscomplete.shape.fill.facing import (
    Around,
    _axes,
    _passed_on,
    cameras_around,
    look_around,
    outward_normals,
    pictures_of_normals,
)
from gscomplete.splats import Splats, concatenate
from gscomplete.splats.rotations import thinnest_axes
from tests.builders.objects import ball, even_ball, pipe, round_splats

WALL, PIXEL, SQUARE = 0.004, 1.6 / 192, 0.3
BLANK = Around(cameras_around(), torch.zeros(48, 192, 192), torch.zeros(48, 192, 192))


def slow_pixel(around: Around, point, view: int) -> tuple[float, float, float]:
    """Return the column, row and depth of a point, not yet rounded or clamped, in float64."""
    pose = around.cameras.camera_from_world[view].double().numpy()
    x, y, depth = pose[:3, :3] @ point + pose[:3, 3]
    focal = around.cameras.focal_px[view].double().numpy()
    middle = around.cameras.center_px[view].double().numpy()
    return x / depth * focal[0] + middle[0], y / depth * focal[1] + middle[1], depth


def slow_normal(splats: Splats, around: Around, number: int):
    """Return the normal of one splat, vote by vote, and how near a vote came to falling."""
    axis = thinnest_axes(splats.quaternions, splats.scales)[number].double().numpy()
    point = splats.means[number].double().numpy()
    front = back = 0.0
    nearest = math.inf
    for view in range(48):
        column, row, far = slow_pixel(around, point, view)
        nearest = min(nearest, *(abs(v - round(v)) for v in (column, row)))
        row, column = (min(max(math.floor(v), 0), 191) for v in (row, column))
        way = around.cameras.positions[view].double().numpy() - point
        cosine = axis @ way / np.linalg.norm(way)
        slope = math.sqrt(1 - cosine**2) / max(abs(cosine), SQUARE)
        allowed = WALL + (PIXEL + 1.5 * float(splats.scales[number].max())) * slope
        behind = far - float(around.depth[view, row, column])
        nearest = min(nearest, abs(behind - allowed))
        if behind < allowed:
            front, back = front + max(cosine, 0), back + max(-cosine, 0)
    return axis * (front - back) / max(front + back, 1e-6), nearest


def test_cameras_are_spread_evenly_and_look_at_the_middle():
    cameras = cameras_around()
    places = cameras.positions.double()
    ways = places / places.norm(dim=1, keepdim=True)
    asked = torch.randn(500, 3, generator=torch.Generator().manual_seed(0)).double()
    asked /= asked.norm(dim=1, keepdim=True)
    apart = torch.rad2deg((ways @ ways.T - 2 * torch.eye(48)).amax(dim=1).clamp(-1, 1).arccos())
    # 48 caps of 16.6 degrees have the area of the sphere
    assert float(apart.min()) > 16.6
    assert float(torch.rad2deg((asked @ ways.T).amax(dim=1).arccos()).max()) < 1.6 * 16.6
    assert float(ways.mean(dim=0).norm()) < 0.02
    for view in range(48):
        column, row, far = slow_pixel(BLANK, np.zeros(3), view)
        assert (column, row) == pytest.approx((96, 96), abs=1e-3)
        assert far == pytest.approx(float(places[view].norm()))


def test_a_view_shows_1_6_object_sizes():
    for view in (0, 20, 47):
        pose = cameras_around().camera_from_world[view].double().numpy()
        right = pose[0, :3]
        columns = [slow_pixel(BLANK, away * right, view)[0] for away in (-0.8, 0.8)]
        assert columns == pytest.approx([0, 192], abs=1e-3)


def test_pixels_and_ways_are_those_of_points_one_by_one():
    points = 2 * torch.rand(40, 3, generator=torch.Generator().manual_seed(0)) - 1
    for view in (0, 13, 47):
        row, column, far = BLANK.pixels(points, view)
        ways = BLANK.ways(points, view).double().numpy()
        eye = BLANK.cameras.positions[view].double().numpy()
        for number, point in enumerate(points.double().numpy()):
            x, y, depth = slow_pixel(BLANK, point, view)
            # float32 keeps places in a picture of 192 pixels to 1e-4; none here is that near
            expected = [min(max(math.floor(v), 0), 191) for v in (y, x)]
            assert [int(row[number]), int(column[number])] == expected
            assert float(far[number]) == pytest.approx(depth, abs=1e-5)
            way = (eye - point) / np.linalg.norm(eye - point)
            assert ways[number] == pytest.approx(way, abs=1e-6)


def test_points_behind_a_camera_fall_into_the_picture_at_the_least_depth():
    eye = BLANK.cameras.positions[0].float()
    row, column, far = BLANK.pixels(torch.stack([1.5 * eye, eye]), 0)
    assert far.tolist() == pytest.approx([1e-3, 1e-3])
    assert int(row.min()) >= 0
    assert int(max(row.max(), column.max())) <= 191


@pytest.mark.parametrize("splats", [pipe(400), ball(300)], ids=["pipe", "ball"])
def test_normals_are_those_of_votes_counted_one_by_one(splats):
    around = look_around(splats)
    found = outward_normals(splats, around).double().numpy()
    compared = 0
    for number in range(0, len(splats), 8):
        expected, nearest = slow_normal(splats, around, number)
        if nearest > 2e-5:  # float32 may decide otherwise nearer to a border
            compared += 1
            assert found[number] == pytest.approx(expected, abs=1e-4)
    assert compared > 20


def test_normals_point_outward_and_a_sheet_has_none():
    whole = ball(3000)
    normals = outward_normals(whole, look_around(whole))
    assert ((normals * whole.means).sum(dim=1) / 0.4 > 0.8).all()
    flat = whole.means.clone()
    flat[:, 2] *= 0.001
    sheet = dataclasses.replace(
        whole, means=flat, quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(3000, 1)
    )
    assert outward_normals(sheet, look_around(sheet)).norm(dim=1).mean() < 0.1


def test_round_splats_take_the_plane_of_their_neighbours():
    flat = even_ball(1500, 0.4)
    rounds = round_splats(flat.means, scale=0.01)
    ways = flat.means / 0.4
    axes = _axes(rounds)
    for number in range(0, 1500, 100):
        apart = (rounds.means - rounds.means[number]).double().norm(dim=1)
        near = rounds.means[apart.argsort()[:12]].double().numpy()
        _, _, across = np.linalg.svd(near - near.mean(axis=0))
        assert abs(axes[number].double().numpy() @ across[2]) > 1 - 1e-5  # float32 offsets
    assert float((axes * ways).sum(dim=1).abs().min()) > 0.98
    mixed = concatenate([flat, round_splats(torch.tensor([[0.0, 0.0, 0.4]]), scale=0.01)])
    assert torch.equal(_axes(mixed)[:-1], thinnest_axes(flat.quaternions, flat.scales))
    assert abs(float(_axes(mixed)[-1, 2])) > 0.98


def test_a_disc_deep_inside_faces_the_wall_next_to_it():
    """It is seen from nowhere, and its eleven neighbours are discs of the wall at +x."""
    hidden = even_ball(3000, 0.4).select(torch.tensor([0]))
    turn = torch.tensor([[0.5**0.5, 0.0, 0.5**0.5, 0.0]])  # z onto x
    hidden = dataclasses.replace(hidden, means=torch.tensor([[0.1, 0.0, 0.0]]), quaternions=turn)
    splats = concatenate([even_ball(3000, 0.4), hidden])
    normal = outward_normals(splats, look_around(splats))[-1]
    assert normal.tolist() == pytest.approx([1.0, 0.0, 0.0], abs=0.1)


def test_what_no_camera_sees_faces_as_its_neighbours_do():
    line = np.stack([np.linspace(0, 1, 30), np.zeros(30), np.zeros(30)], axis=1).astype(np.float32)
    axes = torch.tensor([[0.0, 0.0, 1.0]]).repeat(30, 1)
    axes[1::2] *= -1
    known = torch.ones(30, dtype=torch.bool)
    known[12:15] = False
    normals = torch.where(known[:, None], torch.tensor([0.0, 0.0, 0.9]), torch.zeros(3))
    found = _passed_on(line, axes, normals.clone(), known=known)
    assert torch.equal(found[known], normals[known])
    assert bool((found[12:15, 2] > 0.6).all())
    assert not found[:, :2].any()
    for every in (torch.ones_like(known), torch.zeros_like(known)):
        assert torch.equal(_passed_on(line, axes, normals, known=every), normals)


def test_what_is_passed_on_is_the_mean_of_the_twelve_nearest_six_times_over():
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (50, 3)).astype(np.float32)
    axes = torch.from_numpy(rng.normal(size=(50, 3))).float()
    axes /= axes.norm(dim=1, keepdim=True)
    known = torch.from_numpy(rng.random(50) < 0.5)
    start = axes * known[:, None] * 0.7
    expected = start.double().numpy()
    wide = points.astype(np.float64)
    for _ in range(6):
        after = expected.copy()
        for number in np.flatnonzero(~known.numpy()):
            near = np.argsort(np.linalg.norm(wide - wide[number], axis=1))[:12]
            mean = expected[near].mean(axis=0)
            axis = axes[number].double().numpy()
            after[number] = np.sign(mean @ axis) * np.linalg.norm(mean) * axis
        expected = after
    found = _passed_on(points, axes, start, known=known)
    assert found.numpy() == pytest.approx(expected, abs=1e-6)


def test_pictures_show_the_normals_of_a_ball_and_nothing_beside_it():
    whole = even_ball(3000, 0.4)
    around = look_around(whole)
    facing = pictures_of_normals(whole, whole.means / 0.4, around)
    assert facing.shape == (48, 192, 192, 3)
    ways = around.cameras.positions.float()
    ways = ways / ways.norm(dim=1, keepdim=True)
    assert float((facing[:, 96, 96] - ways).abs().max()) < 0.1  # splats are 0.065 of a radius apart
    assert float(around.alpha[:, 96, 96].min()) > 0.9
    assert not facing[:, :8, :8].any()
    turned = pictures_of_normals(whole, -whole.means / 0.4, around)
    assert float((turned + facing).abs().max()) < 1e-4


@pytest.mark.parametrize("scale", [(0.05, 0.05, 0.002), (0.05, 0.05, 0.05)])
def test_a_lone_splat_is_seen_from_both_sides(scale):
    lone = dataclasses.replace(round_splats([[0.1, 0.0, 0.0]]), scales=torch.tensor([scale]))
    normals = outward_normals(lone, look_around(lone))
    assert normals.shape == (1, 3)
    assert float(normals.norm()) < 0.1
