"""The object frame is exact for any up axis, place and size."""

import dataclasses
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.errors import UserError
from gscomplete.splats.transform import transform_splats
from gscomplete.views import ObjectFrame, axis_direction, parse_up, up_rotation
from tests.builders.objects import random_splats

AXES = ["X", "Y", "Z", "-X", "-Y", "-Z"]
far = st.floats(-1e6, 1e6)
frames = st.builds(
    ObjectFrame,
    up=st.sampled_from([*AXES, "0.1,-0.8,-0.6", "-3,4e2,1"]),
    center_file=st.tuples(far, far, far),
    size_file=st.floats(-6, 6).map(lambda power: 10.0**power),
)


@pytest.mark.parametrize("up", AXES)
def test_rotation_is_proper_and_lifts_the_axis_to_z(up: str) -> None:
    rotation = up_rotation(up)
    assert torch.equal(rotation @ rotation.T, torch.eye(3, dtype=torch.float64))
    assert torch.linalg.det(rotation) == pytest.approx(1.0)
    axis = torch.zeros(3, dtype=torch.float64)
    axis["XYZ".index(up[-1])] = -1.0 if up[0] == "-" else 1.0
    assert torch.equal(rotation @ axis, torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64))


directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda d: sum(v * v for v in d) > 1e-3)


@given(directions)
def test_a_direction_is_lifted_by_the_shortest_way_from_its_axis(
    direction: tuple[float, float, float],
) -> None:
    rotation = up_rotation(",".join(map(str, direction)))
    unit = torch.nn.functional.normalize(torch.tensor(direction, dtype=torch.float64), dim=0)
    # Rounding of some float64 products.
    assert torch.allclose(rotation @ rotation.T, torch.eye(3, dtype=torch.float64), atol=1e-14)
    assert torch.linalg.det(rotation) == pytest.approx(1.0)
    assert torch.allclose(rotation @ unit, torch.tensor([0.0, 0.0, 1.0]).double(), atol=1e-14)
    shares = {up: float(up_rotation(up)[2] @ unit) for up in AXES}
    most = max(shares.values())
    nearest = [up_rotation(up) for up in AXES if shares[up] > most - 1e-9]
    cosines = [float(torch.trace(rotation @ near.T) - 1) / 2 for near in nearest]
    assert any(cosine == pytest.approx(most, abs=1e-12) for cosine in cosines)


def test_a_direction_along_an_axis_is_that_axis() -> None:
    for up in AXES:
        direction = axis_direction(up)
        text = ",".join(f"{2.5 * v:g}" for v in direction)
        assert torch.equal(up_rotation(text), up_rotation(up))
        assert axis_direction(text) == direction


@pytest.mark.parametrize("text", ["", "W", "1,2", "0,0,0", "1,2,nan", "1,inf,0", "z"])
def test_what_is_no_direction_is_told(text: str) -> None:
    with pytest.raises(UserError, match=r"--up: expected one of Z, .* or a direction X,Y,Z"):
        parse_up(text)


def test_documented_table() -> None:
    point = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)
    table = {"Z": [1, 2, 3], "-Z": [1, -2, -3], "Y": [1, -3, 2], "-Y": [1, 3, -2]}
    table |= {"X": [-3, 2, 1], "-X": [3, 2, -1]}
    for up, expected in table.items():
        assert (up_rotation(up) @ point).tolist() == expected


@given(frames, st.tuples(*[st.floats(-0.5, 0.5)] * 3))
@settings(max_examples=80)
def test_center_and_size_map_to_origin_and_one(
    frame: ObjectFrame, offset: tuple[float, float, float]
) -> None:
    center = torch.tensor(frame.center_file, dtype=torch.float64)
    step = torch.tensor(offset, dtype=torch.float64)
    points = torch.stack([center, center + frame.size_file * step])
    found = frame.object_from_file.apply(points)
    # What remains is the rounding of file coordinates themselves in float64.
    rounding = 1e-15 * (1.0 + float(center.abs().max()) / frame.size_file)
    assert found[0].abs().max() <= 4 * rounding
    expected = up_rotation(frame.up) @ step
    assert (found[1] - expected).abs().max() <= 8 * rounding
    back = frame.file_from_object.apply(found)
    assert (back - points).abs().max() <= 16 * rounding * frame.size_file


@given(frames)
@settings(max_examples=40)
def test_json_round_trip(frame: ObjectFrame) -> None:
    assert ObjectFrame.from_json(frame.to_json(), "run.json") == frame


@given(frames)
@settings(max_examples=40)
def test_from_z_up_center(frame: ObjectFrame) -> None:
    center = up_rotation(frame.up) @ torch.tensor(frame.center_file, dtype=torch.float64)
    x, y, z = center.tolist()
    found = ObjectFrame.from_z_up(frame.up, (x, y, z), frame.size_file)
    assert (found.up, found.size_file) == (frame.up, frame.size_file)
    # Axes only swap coordinates; a direction's rotation and its inverse round them.
    rounding = 0.0 if frame.up in AXES else 1e-15 * max(map(abs, frame.center_file))
    assert found.center_file == pytest.approx(frame.center_file, rel=0, abs=4 * rounding)


def test_bad_values_are_named() -> None:
    for size in (0.0, 5e-324, math.nan):
        with pytest.raises(ValueError, match="size_file"):
            ObjectFrame("Z", (0.0, 0.0, 0.0), size)
    with pytest.raises(ValueError, match="center_file"):
        ObjectFrame("Z", (0.0, math.nan, 0.0), 1.0)
    with pytest.raises(ValueError, match="up"):
        ObjectFrame("W", (0.0, 0.0, 0.0), 1.0)
    with pytest.raises(UserError, match=r"run\.json: .*up: expected one of"):
        ObjectFrame.from_json({"up": "z", "center_file": [0, 0, 0], "size_file": 1}, "run.json")


def test_the_frame_of_splats_holds_the_middle_of_their_centres() -> None:
    splats = random_splats(5000)
    moved = transform_splats(splats, ObjectFrame.about(splats, "Y").object_from_file).means
    outside = (moved.abs() > 0.5 + 1e-5).float().mean(dim=0)
    assert float(outside.max()) == pytest.approx(0.001, abs=0.0003)  # whole splats: 2 or 3 a side
    single = splats.select(torch.arange(5000) == 4)
    assert ObjectFrame.about(single, "Z").size_file == pytest.approx(float(single.scales.max()))


def test_floaters_do_not_decide_the_frame_and_are_counted() -> None:
    """Of 300 splats the middle 99.9 % would reach to any of five."""
    splats = random_splats(300)
    far_away = torch.tensor([[1e3, 0, 0], [50, 40, 0], [0, 0, -1e5], [1e3, 1, 0], [0, 1e3, 0]])
    means = torch.cat([splats.means[:295], far_away])
    frame = ObjectFrame.without_floaters(dataclasses.replace(splats, means=means), "Y")
    assert frame == ObjectFrame.about(splats.select(slice(0, 295)), "Y")
    assert frame.count_outside(dataclasses.replace(splats, means=means), 0.8) == 5
    assert frame.count_outside(splats, 0.8) == 0


def test_one_splat_that_is_far_too_large_does_not_shrink_the_object() -> None:
    splats = random_splats(30)
    expected = ObjectFrame.about(splats, "Z")
    scales = splats.scales.clone()
    scales[3] = 1000.0
    assert ObjectFrame.about(dataclasses.replace(splats, scales=scales), "Z") == expected
