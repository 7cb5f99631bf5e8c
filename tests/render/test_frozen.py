"""A prepared frozen set gives the bits that the plain one gives, and draws what it is asked to."""

import dataclasses
from unittest import mock

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gscomplete.render import RenderSettings, join_prepared, prepare_frozen, render
from gscomplete.render.cpu import view
from gscomplete.render.cpu.composite import STOP_EVERY
from gscomplete.splats import Splats, concatenate
from gscomplete.views import Cameras, four_view_orbit


def cloud(seed: int, count: int, *, degree: int = 0, scale: float, opaque: bool) -> Splats:
    """Splats about the origin; a third lies on one plane grid, where depths are equal."""
    g = torch.Generator().manual_seed(seed)
    means = 0.5 * torch.randn(count, 3, generator=g)
    means[::3] = (2.0 * means[::3]).round() / 2.0
    opacities = torch.rand(count, generator=g)
    return Splats(
        means,
        torch.nn.functional.normalize(torch.randn(count, 4, generator=g), dim=1),
        scale * torch.exp(0.7 * torch.randn(count, 3, generator=g)),
        0.9 + 0.1 * opacities if opaque else opacities,
        0.6 * torch.randn(count, (degree + 1) ** 2, 3, generator=g),
    )


def views(width: int, height: int, radius: float = 2.5) -> Cameras:
    square = four_view_orbit(0.0, 0.0, radius=radius, fov_deg=45.0, size_px=max(width, height))
    return dataclasses.replace(square, width=width, height=height)[:2]


def drawn(splats, cameras, frozen, options):
    """Image, gradients and screen gradients; part of the image gets no gradient."""
    leaves = Splats(**{name: value.clone().requires_grad_() for name, value in splats.fields()})
    offsets = torch.zeros(len(cameras), len(splats), 2, requires_grad=True)
    picture = render(leaves, cameras, frozen=frozen, screen_offsets=offsets, settings=options)
    g = torch.Generator().manual_seed(1)
    weights = torch.randn(picture.color.shape, generator=g)
    weights[:, :, : cameras.width // 2] = 0.0
    ((picture.color * weights).sum() + (picture.depth * weights[..., 0]).sum()).backward()
    gradients = [value.grad for _, value in leaves.fields()]
    return [picture.color, picture.alpha, picture.depth, *gradients, offsets.grad]


def assert_same_bits(one, other):
    for a, b in zip(one, other, strict=True):
        assert torch.equal(a, b)


scenes = {
    "seed": st.integers(0, 10_000),
    "frozen_count": st.sampled_from([0, 1, 60, 800]),
    "new_count": st.sampled_from([0, 1, 40, 300]),
    "scale": st.sampled_from([0.01, 0.06, 0.4]),
    "opaque": st.booleans(),
    "degrees": st.tuples(st.integers(0, 3), st.integers(0, 3)),
    "size": st.sampled_from([(8, 8), (1, 1), (37, 21), (5, 66), (64, 64)]),
    "stop": st.sampled_from([0.0, 1e-5, 1e-4, 0.5]),
}


@settings(max_examples=60, deadline=None)
@given(**scenes)
@example(3, 800, 300, 0.4, True, (0, 0), (64, 64), 1e-5)
def test_same_bits_as_the_plain_frozen_set(
    seed, frozen_count, new_count, scale, opaque, degrees, size, stop
):
    old = cloud(seed, frozen_count, degree=degrees[0], scale=scale, opaque=opaque)
    new = cloud(seed + 1, new_count, degree=degrees[1], scale=0.5 * scale, opaque=False)
    cameras = views(*size)
    plain = drawn(new, cameras, old, RenderSettings(transmittance_min=stop))
    options = RenderSettings(transmittance_min=stop)
    for skip in (True, False):
        with mock.patch.object(view, "_SKIP_IDLE_TILES", skip):
            assert_same_bits(drawn(new, cameras, old, options), plain)
            prepared = prepare_frozen(old, cameras, options)
            assert_same_bits(drawn(new, cameras, prepared, options), plain)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), stop=st.sampled_from([1e-5, 0.1]), shift=st.integers(0, 9))
def test_lists_end_where_nothing_more_can_be_seen(seed, stop, shift):
    """An opaque stack, met by new splats anywhere in it, in every phase of the stop's rhythm."""
    g = torch.Generator().manual_seed(seed)
    depth = torch.linspace(-0.5, 0.5, 120)
    stack = Splats(
        torch.stack([depth, torch.zeros(120), torch.zeros(120)], dim=1),
        torch.tensor([[1.0, 0, 0, 0]]).repeat(120, 1),
        torch.full((120, 3), 2.0),
        torch.rand(120, generator=g).clamp(0.05, 0.9),
        torch.randn(120, 1, 3, generator=g),
    )
    among = stack.select(torch.randperm(120, generator=g)[:shift])
    among = Splats(0.9 * among.means, *(value for n, value in among.fields() if n != "means"))
    camera = views(16, 16)[:1]
    options = RenderSettings(transmittance_min=stop)
    prepared = prepare_frozen(stack, camera, options)
    lists = prepared.views[0].lists
    kept = lists.tile_start[1:] - lists.tile_start[:-1]
    assert (lists.done + STOP_EVERY - 1 == kept).all(), "every tile was cut"
    assert len(lists.rows) < 120, "what is behind is not kept"
    assert_same_bits(drawn(among, camera, prepared, options), drawn(among, camera, stack, options))


def test_new_splats_behind_an_opaque_set_cost_nothing():
    front = cloud(0, 3000, scale=0.3, opaque=True)
    camera = views(32, 32)[:1]
    hidden = cloud(1, 50, scale=0.01, opaque=False)
    hidden = Splats(hidden.means * 0.1, *(v for n, v in hidden.fields() if n != "means"))
    prepared = prepare_frozen(front, camera)
    values = drawn(hidden, camera, prepared, RenderSettings())
    assert torch.equal(values[0], prepared.picture().color)
    assert not any(bool(value.any()) for value in values[3:])


def test_its_own_picture_is_the_render_of_the_set():
    old, cameras = cloud(5, 500, scale=0.05, opaque=False), views(40, 24)
    for backend in ("cpu", "reference"):
        prepared = prepare_frozen(old, cameras, backend=backend)
        ours = prepared.picture(torch.full((3,), 0.5))
        theirs = render(old, cameras, torch.full((3,), 0.5), backend=backend)
        for name in ("color", "alpha", "depth"):
            assert torch.equal(getattr(ours, name), getattr(theirs, name)), name
    assert prepared.nbytes > 0


def test_views_are_chosen_and_joined():
    old, new = (cloud(seed, 300, scale=0.05, opaque=False) for seed in (1, 2))
    ring = four_view_orbit(0.0, 10.0, radius=2.5, fov_deg=45.0, size_px=24)
    other = four_view_orbit(40.0, -10.0, radius=2.0, fov_deg=45.0, size_px=24)[:1]
    base = prepare_frozen(old, ring)
    joined = join_prepared([base[1:3], prepare_frozen(old, other), base[-1]])
    assert len(joined) == 4
    nothing = base[4:]
    assert len(render(new, nothing.cameras, frozen=nothing).color) == len(nothing.picture().alpha)
    assert_same_bits(
        drawn(new, joined.cameras, joined, RenderSettings()),
        drawn(new, joined.cameras, old, RenderSettings()),
    )


def test_other_views_or_settings_are_refused():
    old, cameras = cloud(1, 20, scale=0.05, opaque=False), views(16, 16)
    prepared = prepare_frozen(old, cameras)
    with pytest.raises(ValueError, match="prepared for 2 views of 16 x 16"):
        render(old, cameras[:1], frozen=prepared)
    with pytest.raises(ValueError, match="prepared for 2 views"):
        render(old, views(16, 16, radius=2.6), frozen=prepared)
    with pytest.raises(ValueError, match="prepared with"):
        render(old, cameras, frozen=prepared, settings=RenderSettings(near=0.5))
    with pytest.raises(ValueError, match="same splats"):
        join_prepared([prepared, prepare_frozen(cloud(2, 20, scale=0.05, opaque=True), cameras)])
    with pytest.raises(ValueError, match="found none"):
        join_prepared([])


def test_backends_without_lists_draw_the_splats_themselves():
    old, new = (cloud(seed, 60, scale=0.1, opaque=False) for seed in (1, 2))
    cameras = views(16, 16)
    expected = render(new, cameras, frozen=old)
    for made, used in (("cpu", "reference"), ("reference", "cpu")):
        prepared = prepare_frozen(old, cameras, backend=made)
        picture = render(new, cameras, frozen=prepared, backend=used)
        torch.testing.assert_close(picture.color.float(), expected.color, rtol=0, atol=2e-3)


@pytest.mark.parametrize(("old_degree", "new_degree"), [(3, 0), (0, 3), (2, 1)])
def test_sets_keep_their_own_degree(old_degree, new_degree):
    old = cloud(1, 200, degree=old_degree, scale=0.05, opaque=False)
    new = cloud(2, 200, degree=new_degree, scale=0.05, opaque=False)
    cameras = views(32, 32)
    split = drawn(new, cameras, old, RenderSettings())
    same = max(old_degree, new_degree)
    raised = drawn(new.with_sh_degree(same), cameras, old.with_sh_degree(same), RenderSettings())
    whole = render(concatenate([old, new]), cameras)
    assert torch.equal(split[0], whole.color)
    bands = (new_degree + 1) ** 2
    for name, one, other in zip(("m", "q", "s", "o", "sh"), split[3:8], raised[3:8], strict=True):
        other = other[:, :bands] if name == "sh" else other
        torch.testing.assert_close(one, other, rtol=1e-6, atol=1e-9)


def test_zero_bands_change_no_bit():
    base = cloud(3, 300, degree=1, scale=0.05, opaque=False)
    padded, cameras = base.with_sh_degree(3), views(32, 32)
    one = drawn(base, cameras, None, RenderSettings())
    other = drawn(padded, cameras, None, RenderSettings())
    assert_same_bits(one[:3], other[:3])
    assert other[7][:, 4:].abs().sum() > 0, "zero bands still get gradients"


def test_box_lists_draw_the_same_picture():
    base, cameras = cloud(4, 500, scale=0.1, opaque=True), views(64, 64)
    exact = RenderSettings(transmittance_min=0.0)
    boxes = dataclasses.replace(exact, exact_tile_lists=False)
    assert_same_bits(drawn(base, cameras, None, exact)[:3], drawn(base, cameras, None, boxes)[:3])
