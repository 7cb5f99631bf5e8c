"""Values that lack a conversion are told from sound ones, at and about every limit."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from gscomplete.splats import Splats
from gscomplete.splats.linear_values import linear_values, linear_values_of
from tests.builders.objects import ball, random_splats

MEANS = np.random.default_rng(0).uniform(-1, 1, (400, 3)).astype(np.float32)
SOUND = {"opacity": (-3.0, 5.0), "scale": (-6.0, -4.0), "base": (-1.5, 1.5)}


def found(means=MEANS, typical=-4.0, **changes) -> list[tuple[str, bool]]:
    """Return names and sureness; ``typical`` is every splat's largest logarithm."""
    logs = np.full(len(means), typical)
    values = linear_values(means, logs, **(SOUND | changes))
    return [(value.name, value.is_sure) for value in values]


def raw(degree: int = 0) -> Splats:
    """Return splats as a file of linear values in [0, 1] is read."""
    values = torch.rand(500, 7, generator=torch.Generator().manual_seed(1))
    means = 2 * torch.rand(500, 3, generator=torch.Generator().manual_seed(2)) - 1
    sound = random_splats(500, degree)
    sh = sound.sh.clone()
    sh[:, 0] = values[:, :3]
    scales = (0.02 * values[:, 3:6]).exp()
    return Splats(means, sound.quaternions, scales, torch.sigmoid(values[:, 6]), sh)


def test_sound_values_are_not_doubted():
    assert found() == []
    assert linear_values_of(ball(500)) == []
    assert linear_values_of(random_splats(500)) == []


@pytest.mark.parametrize(
    ("ends", "expected"),
    [
        ((0.0, 1.0), [("linear_opacity", True)]),
        ((0.0, 0.51), [("linear_opacity", True)]),
        ((0.0, 0.5), [("linear_opacity", False)]),
        ((0.4, 0.46), [("linear_opacity", False)]),
        ((0.0, 0.05), []),
        ((0.9, 0.9), []),
        ((-0.01, 1.0), []),
        ((0.0, 1.01), []),
    ],
)
def test_opacities_are_linear_where_all_are_shares_that_spread(ends, expected):
    assert found(opacity=ends) == expected


@pytest.mark.parametrize(
    ("ends", "expected"),
    [
        ((0.0, 1.0), [("linear_color", False)]),
        ((0.0, 0.51), [("linear_color", False)]),
        ((0.0, 0.5), []),
        ((0.0, 1.01), []),
        ((0.0, 20.0), []),
        ((0.0, 20.1), [("linear_color", True)]),
        ((-0.01, 255.0), []),
    ],
)
def test_colours_are_linear_where_all_are_of_one_or_of_255(ends, expected):
    assert found(base=ends) == expected


def test_scales_are_linear_where_as_logarithms_they_are_too_large():
    """The limit is a quarter of the largest side of the middle 90 %, reckoned here by hand."""
    ordered = np.sort(MEANS.astype(np.float64), axis=0)
    place = 0.05 * 399
    low, rest = int(place), place - int(place)
    ends = [(1 - rest) * ordered[k] + rest * ordered[k + s] for k, s in ((low, 1), (-1 - low, -1))]
    limit = 0.25 * float((ends[1] - ends[0]).max())
    yes, no = [("linear_scale", True)], []
    for typical, expected in ((limit - 1e-4, yes), (limit + 1e-4, no), (0.0, yes)):
        assert found(typical=typical, scale=(0.0, 3.0)) == expected
    assert found(typical=0.01, scale=(-0.001, 3.0)) == no
    # the same splats in a scene so large that exp(0.01) is small in it
    assert found(MEANS * 4 / limit, 0.01, scale=(0.0, 3.0)) == no
    assert found(MEANS / limit * 0.99, 0.01, scale=(0.0, 3.0)) == yes


def test_half_of_the_splats_decide_what_is_typical():
    for few, expected in ((199, 1), (201, 0)):
        logs = np.where(np.arange(400) < few, 9.0, 0.01)
        assert len(linear_values(MEANS, logs, **(SOUND | {"scale": (0.0, 9.0)}))) == expected


def test_scales_beyond_floats_are_told():
    (value,) = linear_values(1e4 * MEANS, np.full(400, 900.0), **(SOUND | {"scale": (0.0, 1e3)}))
    assert (value.name, f"{math.exp(80):.3g}" in value.message) == ("linear_scale", True)


def test_fewer_than_a_hundred_splats_tell_nothing():
    linear = {"opacity": (0.0, 1.0), "base": (0.0, 1.0)}
    assert found(MEANS[:99], **linear) == []
    assert len(found(MEANS[:100], **linear)) == 2
    assert linear_values_of(raw().select(torch.arange(99))) == []


def test_messages_say_what_was_found_and_expected():
    values = linear_values(
        MEANS, np.full(400, 0.02), opacity=(0.01, 0.98), scale=(0.01, 0.03), base=(0.1, 254.9)
    )
    opacity, scale, color = (value.message for value in values)
    assert opacity == "opacities look linear, expected logits: all in [0.01, 0.98]"
    assert scale.startswith(
        "scales look linear, expected logarithms: all positive, typically 0.02;"
    )
    assert "splats of 1.02 in an extent of 1.79" in scale
    assert color == "f_dc looks like RGB, expected (RGB - 0.5) / 0.2821: all in [0.1, 255]"


@pytest.mark.parametrize("degree", [0, 2])
def test_a_file_of_linear_values_is_known_by_what_reading_made_of_it(degree):
    names = [(value.name, value.is_sure) for value in linear_values_of(raw(degree))]
    assert names == [("linear_opacity", True), ("linear_scale", True), ("linear_color", False)]


def test_the_largest_deviation_of_a_splat_counts():
    """Splats of exp(5) along one axis are no deviations written as they are."""
    scales = raw().scales * torch.tensor([1.0, math.exp(5), 1.0])
    names = [v.name for v in linear_values_of(dataclasses.replace(raw(), scales=scales))]
    assert names == ["linear_opacity", "linear_color"]


def test_what_float32_rounds_off_does_not_hide_linear_opacities():
    opacities = torch.sigmoid(torch.linspace(0, 1, 500))
    opacities[0] = torch.nextafter(opacities[0], torch.tensor(0.0))
    opacities[-1] = torch.nextafter(opacities[-1], torch.tensor(1.0))
    splats = dataclasses.replace(ball(500), opacities=opacities)
    assert [value.name for value in linear_values_of(splats)] == ["linear_opacity"]


def test_opaque_and_transparent_splats_have_finite_logits():
    opacities = (torch.arange(500) % 2).float()
    splats = dataclasses.replace(ball(500), opacities=opacities)
    assert linear_values_of(splats) == []
    none = dataclasses.replace(raw(), scales=torch.zeros(500, 3))
    assert linear_values_of(none) == []
    assert linear_values_of(ball(500).select(torch.arange(0))) == []


@pytest.mark.parametrize("field", ["means", "scales", "opacities"])
def test_splats_that_cannot_be_drawn_tell_nothing(field):
    """Two of 500 without numbers would hide what the others tell."""
    broken = getattr(raw(), field).clone()
    broken[3], broken[7] = math.nan, math.inf
    splats = dataclasses.replace(raw(), **{field: broken})
    assert [value.name for value in linear_values_of(splats)] == [
        value.name for value in linear_values_of(raw())
    ]
    assert linear_values_of(dataclasses.replace(raw(), **{field: broken * math.nan})) == []


def test_an_even_choice_of_many_is_enough():
    """Of 40,000 every other splat counts, so what is odd tells nothing."""
    many = raw().select(torch.arange(40_000) % 500)
    opacities = many.opacities.clone()
    opacities[1::2] = 0.01
    assert (
        linear_values_of(dataclasses.replace(many, opacities=opacities))[0].name == "linear_opacity"
    )
    opacities = many.opacities.clone()
    opacities[::2] = 0.01
    names = [v.name for v in linear_values_of(dataclasses.replace(many, opacities=opacities))]
    assert names == ["linear_scale", "linear_color"]
