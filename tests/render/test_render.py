"""The CPU renderer against its float64 twin, in values and gradients, and its guarantees."""

import numba
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gscomplete.errors import UserError
from gscomplete.render import RenderSettings, render
from gscomplete.render.cpu import view as one_view
from gscomplete.splats import Splats
from gscomplete.views import Cameras, four_view_orbit
from tests.builders.objects import random_splats, round_splats


def leaves(splats: Splats) -> Splats:
    return Splats(**{name: value.clone().requires_grad_() for name, value in splats.fields()})


def cameras(size_px: int = 48) -> Cameras:
    return four_view_orbit(20.0, 15.0, radius=2.5, fov_deg=45.0, size_px=size_px)


def loss(picture, weights):
    wc, wa, wd = weights
    return (
        (picture.color * wc.to(picture.color)).sum()
        + (picture.alpha * wa.to(picture.alpha)).sum()
        + (picture.depth * wd.to(picture.depth)).sum()
    )


EXACT = RenderSettings(transmittance_min=0.0)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_values_and_gradients_match_float64(degree):
    base = random_splats(400, degree, degree)
    views = cameras()
    g = torch.Generator().manual_seed(7)
    weights = [torch.randn(4, 48, 48, *c, generator=g, dtype=torch.float64) for c in ((3,), (), ())]
    grads = {}
    pictures = {}
    for backend in ("cpu", "reference"):
        splats = leaves(base)
        offsets = torch.zeros(4, len(base), 2, requires_grad=True)
        picture = render(splats, views, screen_offsets=offsets, settings=EXACT, backend=backend)
        loss(picture, weights).backward()
        pictures[backend] = picture
        grads[backend] = {name: value.grad for name, value in splats.fields()}
        grads[backend]["offsets"] = offsets.grad
    # A pixel whose alpha lies within rounding of 1/255 may count in one and not in the other:
    # at most 1/255 in a few pixels. Everywhere else float32 rounding is the only difference.
    error = (pictures["cpu"].color - pictures["reference"].color).abs()
    assert error.max() <= 1 / 255
    assert error.mean() <= 2e-6
    for name, reference in grads["reference"].items():
        difference = (grads["cpu"][name] - reference).norm() / reference.norm()
        assert difference <= 1e-3, (name, float(difference))


def test_what_others_hide_is_left_out_of_the_way_back(monkeypatch):
    """Gradients stay as near to float64: what is left out is below the rounding of the rest."""
    generator = torch.Generator().manual_seed(3)
    points = torch.randn(3000, 3, generator=generator)
    points = 0.4 * points / points.norm(dim=1, keepdim=True)
    colors = torch.rand(3000, 3, generator=generator)
    base = round_splats(points, scale=0.02, opacity=0.95, color=colors)
    weights = [torch.randn(4, 48, 48, *c, generator=generator) for c in ((3,), (), ())]
    hidden: list[float] = []
    way_back = one_view.differentiate

    def counted(view, *arguments, is_first):
        hidden.append(float((view.contributes == 0).mean()))
        way_back(view, *arguments, is_first=is_first)

    monkeypatch.setattr(one_view, "differentiate", counted)
    grads = []
    for chosen, backend in ((EXACT, "reference"), (EXACT, "cpu"), (RenderSettings(), "cpu")):
        splats = leaves(base)
        loss(render(splats, cameras(), settings=chosen, backend=backend), weights).backward()
        grads.append({name: value.grad for name, value in splats.fields()})
    assert max(hidden[:4]) == 0.0
    assert min(hidden[4:]) > 0.3
    for name in ("means", "scales", "opacities", "sh"):
        errors = [(found[name] - grads[0][name]).norm() / grads[0][name].norm() for found in grads]
        assert errors[2] <= 1.1 * errors[1] + 1e-5, name


def test_frozen_splats_are_drawn_but_get_no_gradient():
    base = random_splats(300, seed=3)
    first, second = base.select(torch.arange(100)), base.select(torch.arange(100, 300))
    trainable = leaves(second)
    together = leaves(base)
    views = cameras()
    split = render(trainable, views, frozen=first)
    whole = render(together, views)
    assert torch.equal(split.color, whole.color)
    split.color.square().sum().backward()
    whole.color.square().sum().backward()
    for name, value in trainable.fields():
        assert torch.equal(value.grad, getattr(together, name).grad[100:]), name


def test_same_bits_for_one_and_two_threads():
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("numba was started with one thread, so two cannot be asked for")
    results = []
    before = numba.get_num_threads()
    for threads in (1, 2):
        numba.set_num_threads(threads)
        splats = leaves(random_splats(2000, 1, 5))
        picture = render(splats, cameras(100))
        picture.color.square().sum().backward()
        results.append([picture.color.detach(), *(v.grad for _, v in splats.fields())])
    numba.set_num_threads(before)
    for one, two in zip(*results, strict=True):
        assert torch.equal(one, two)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 1000),
    scale=st.sampled_from([1e-8, 1e-4, 0.01, 1.0, 100.0]),
    ratio=st.sampled_from([1.0, 1e-3, 1e-6]),
    spread=st.sampled_from([0.1, 1.0, 30.0]),
    fov=st.sampled_from([1.0, 40.0, 120.0, 170.0]),
    width=st.sampled_from([1, 7, 33]),
)
def test_extreme_splats_stay_finite_and_close(seed, scale, ratio, spread, fov, width):
    g = torch.Generator().manual_seed(seed)
    count = 40
    base = Splats(
        spread * torch.randn(count, 3, generator=g),
        torch.randn(count, 4, generator=g) * 10.0 ** torch.randint(-6, 6, (count, 1), generator=g),
        torch.tensor([scale, scale * ratio, scale * ratio]).repeat(count, 1),
        torch.rand(count, generator=g),
        torch.randn(count, 1, 3, generator=g),
    )
    views = four_view_orbit(0.0, 10.0, radius=2.0, fov_deg=fov, size_px=width)
    splats = leaves(base)
    picture = render(splats, views)
    (picture.color.sum() + picture.depth.sum()).backward()
    for value in (
        picture.color,
        picture.alpha,
        picture.depth,
        *(v.grad for _, v in splats.fields()),
    ):
        assert torch.isfinite(value).all()
    reference = render(base, views, backend="reference")
    # Every splat whose alpha sits on the 1/255 threshold of a pixel may flip: allow a few.
    assert (picture.alpha - reference.alpha).abs().max() <= 0.02


def test_nothing_to_draw():
    empty = random_splats(3).select(torch.zeros(3, dtype=torch.bool))
    background = torch.tensor([0.2, 0.4, 0.6])
    picture = render(empty, cameras(), background)
    assert torch.equal(picture.color, background.expand_as(picture.color))
    assert not picture.alpha.any()
    behind = random_splats(50)
    far = Splats(behind.means + 100.0, *(v for n, v in behind.fields() if n != "means"))
    assert not render(far, cameras()).alpha.any()


def test_splats_that_make_no_sense_are_not_drawn():
    base = random_splats(50, seed=1)
    broken = Splats(**{n: v.clone() for n, v in base.fields()})
    broken.means[0] = torch.nan
    broken.scales[1] = torch.inf
    broken.opacities[2] = torch.nan
    broken.sh[3] = torch.nan
    broken.sh[4, 0, 1] = -torch.inf
    broken.quaternions[5] = torch.inf
    broken.means[6] = 1e38
    broken.opacities[7] = torch.inf
    broken.opacities[8] = 1e4  # its alpha would not fall off: exponents end at -12
    rest = torch.ones(50, dtype=torch.bool)
    rest[:9] = False
    for backend in ("cpu", "reference"):
        drawn = render(broken, cameras(), backend=backend)
        expected = render(base.select(rest), cameras(), backend=backend)
        assert torch.allclose(drawn.color, expected.color, rtol=0, atol=1e-12)
        assert torch.allclose(drawn.alpha, expected.alpha, rtol=0, atol=1e-12)


def test_depth_is_the_distance_of_an_opaque_wall():
    count = 2500
    grid = torch.stack(torch.meshgrid(*[torch.linspace(-1, 1, 50)] * 2, indexing="ij"), dim=-1)
    means = torch.cat([torch.zeros(count, 1), grid.reshape(-1, 2)], dim=1)
    wall = Splats(
        means,
        torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
        torch.tensor([[1e-3, 0.04, 0.04]]).repeat(count, 1),
        torch.full((count,), 0.95),
        torch.zeros(count, 1, 3),
    )
    view = four_view_orbit(0.0, 0.0, radius=3.0, fov_deg=20.0, size_px=32)[0]
    picture = render(wall, view)
    assert picture.alpha[0, 8:24, 8:24].min() > 0.99
    assert torch.allclose(picture.depth[0, 8:24, 8:24], torch.tensor(3.0), atol=1e-4)


@pytest.mark.parametrize("where", ["one view", "one pixel", "everywhere"])
def test_a_nan_gradient_of_the_picture_reaches_the_splats(where):
    """A maximum over a tile would pass over NaN, and the tile would count as without gradient."""
    splats = leaves(random_splats(50))
    picture = render(splats, cameras(16))
    gradient = torch.zeros_like(picture.color)
    gradient[{"one view": 0, "one pixel": (0, 8, 8), "everywhere": slice(None)}[where]] = torch.nan
    picture.color.backward(gradient)
    for name, value in splats.fields():
        assert torch.isnan(value.grad).any(), name


@pytest.mark.parametrize("scale", [1e3, 1e9, 1e17])
def test_splats_far_larger_than_the_image_are_drawn(scale):
    """In float32, squares of such widths leave the range; nothing may vanish because of it."""
    base = random_splats(3, seed=2)
    near = Splats(
        torch.tensor([[1.9, 0.1, 0.0], [1.5, 0.0, 0.2], [0.0, 0.0, 0.0]]),
        base.quaternions,
        torch.tensor([[scale] * 3, [scale, 1e-3, scale], [scale, 1e-3, 1e-3]]),
        torch.tensor([0.3, 0.4, 0.5]),
        base.sh,
    )
    view = four_view_orbit(0.0, 0.0, radius=2.0, fov_deg=1.0, size_px=33)[0]
    for i in range(3):
        alone = leaves(near.select(torch.tensor([i])))
        picture = render(alone, view)
        truth = render(alone.detach(), view, backend="reference")
        assert truth.alpha.max() > 0.2
        assert (picture.alpha - truth.alpha).abs().max() < 1e-3
        picture.color.sum().backward()
        assert all(torch.isfinite(value.grad).all() for _, value in alone.fields())


def test_no_views_give_no_pictures():
    none = cameras(5)[0:0]
    for backend in ("cpu", "reference"):
        assert render(random_splats(3), none, backend=backend).color.shape == (0, 5, 5, 3)


def test_tile_lists_too_long_to_number_are_refused(monkeypatch):
    """Positions in them are int32: past 2^31 they would wrap, and the process write anywhere."""
    monkeypatch.setattr(one_view, "MAX_ENTRIES", 100)
    with pytest.raises(UserError, match="expected at most 100 pairs of a splat and a tile"):
        render(random_splats(300, scale=1.0), cameras())


def test_pixels_at_the_largest_alpha_pass_no_gradient():
    """Only those around them do; with an alpha_max of 0.6 that is less than half of them."""
    gradients = {}
    for backend in ("cpu", "reference"):
        splats = leaves(round_splats(torch.zeros(1, 3), scale=0.5, opacity=1.0))
        settings = RenderSettings(alpha_max=0.6)
        render(splats, cameras(24)[:1], settings=settings, backend=backend).color.sum().backward()
        gradients[backend] = splats
    for name in ("opacities", "scales"):
        found, expected = (getattr(gradients[b], name).grad for b in ("cpu", "reference"))
        assert float(expected.abs().max()) > 1
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-3)


def test_a_faint_splat_is_as_far_away_as_it_is():
    """Expected depth is over what is seen, however little that is."""
    view = four_view_orbit(0.0, 0.0, radius=2.5, fov_deg=45.0, size_px=8)[:1]
    for opacity in (0.02, 0.9):
        picture = render(round_splats(torch.zeros(1, 3), scale=0.5, opacity=opacity), view)
        assert float(picture.alpha[0, 4, 4]) < opacity
        assert float(picture.depth[0, 4, 4]) == pytest.approx(2.5, abs=1e-4)


def test_splats_changed_before_the_way_back_are_noticed():
    splats = leaves(random_splats(20))
    drawn = render(splats, cameras(16)).color.sum()
    with torch.no_grad():
        splats.scales.mul_(2.0)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        drawn.backward()


def test_second_derivatives_are_refused_by_name():
    splats = leaves(random_splats(20))
    drawn = render(splats, cameras(16)).color.square().sum()
    (gradient,) = torch.autograd.grad(drawn, splats.sh, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()


@pytest.mark.parametrize("backend", ["cpu", "reference"])
@pytest.mark.parametrize("shape", [(4, 19, 2), (4, 21, 2), (3, 20, 2), (20, 2)])
def test_offsets_that_do_not_fit_are_refused(shape, backend):
    """A kernel would read beyond their end."""
    with pytest.raises(ValueError, match=r"screen_offsets: expected shape \(4, 20, 2\)"):
        render(random_splats(20), cameras(16), screen_offsets=torch.zeros(shape), backend=backend)


@pytest.mark.parametrize("name", ["float64", "meta"])
def test_pictures_are_float32_on_the_cpu_whatever_the_default(name):
    splats, views = random_splats(20), cameras(16)
    expected = render(splats, views).color
    try:
        if name == "meta":
            torch.set_default_device(name)
        else:
            torch.set_default_dtype(torch.float64)
        found = render(splats, views).color
    finally:
        torch.set_default_device(None)
        torch.set_default_dtype(torch.float32)
    assert found.dtype == torch.float32
    assert torch.equal(found, expected)


def test_a_background_may_be_three_numbers():
    splats, views = random_splats(20), cameras(16)
    expected = render(splats, views, torch.tensor([0.5, 0.25, 1.0])).color
    assert torch.equal(render(splats, views, (0.5, 0.25, 1.0)).color, expected)
