"""Rows about the shapes, opacities, orientations and numbers of splats."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import torch

from gscomplete.render import RenderSettings, render
from gscomplete.splats import Splats, concatenate
from recipes.stress_numerics.rows import (
    Check,
    Row,
    against_twin,
    draw_and_differentiate,
    leaves,
    nonfinite,
)
from recipes.stress_numerics.scenes import front_camera, random_splats, ring, with_fields


def _needles(quick: bool) -> Iterator[Check]:
    base = random_splats(60, 1)
    shape = torch.tensor([0.5, 5e-7, 5e-7])
    yield from against_twin(with_fields(base, scales=shape), ring())


def _pancakes(quick: bool) -> Iterator[Check]:
    base = random_splats(60, 2)
    shape = torch.tensor([0.5, 0.5, 5e-7])
    yield from against_twin(with_fields(base, scales=shape, opacities=0.3), ring())


def _scales(quick: bool) -> Iterator[Check]:
    base = random_splats(44, 3)
    sizes = torch.logspace(-8, 3, 11).repeat(4)[:, None] * torch.tensor([1.0, 0.5, 0.2])
    yield from against_twin(with_fields(base, scales=sizes, opacities=0.2), ring())


def _beyond_scales(quick: bool) -> Iterator[Check]:
    base = random_splats(24, 4)
    sizes = torch.logspace(-30, 15, 24)[:, None] * torch.tensor([1.0, 1e-6, 1.0])
    yield from against_twin(with_fields(base, scales=sizes, opacities=0.2), ring())


def _opacities(quick: bool) -> Iterator[Check]:
    base = random_splats(90, 5)
    logits = torch.tensor([torch.inf, -torch.inf, 90.0, -90.0, 17.0, 0.0])
    levels = torch.cat([torch.sigmoid(logits), torch.tensor([1 / 255, 0.999, 1e-42])])
    yield from against_twin(with_fields(base, opacities=levels.repeat(10)), ring())
    raw = logits.clone().requires_grad_()
    picture = render(
        dataclasses.replace(base.select(torch.arange(6)), opacities=raw.sigmoid()), ring()
    )
    picture.color.sum().backward()
    yield Check("non-finite gradients of logits", nonfinite(raw.grad), 0)


def _quaternions(quick: bool) -> Iterator[Check]:
    base = random_splats(50, 6, scale=0.1)
    lengths = torch.tensor([1e30, 1e-30, 1e-12, 1e12, 3.0]).repeat(10)[:, None]
    stretched = with_fields(base, quaternions=base.quaternions * lengths)
    yield from against_twin(stretched, ring(), gradient_limit=None)
    same = (render(stretched, ring()).color - render(base, ring()).color).abs()
    yield Check("difference from unit quaternions", float(same.max()), 1 / 255)
    zero = with_fields(base, quaternions=0.0)
    yield from against_twin(zero, ring(), label="zero: ", gradient_limit=None)


def _coincident(quick: bool) -> Iterator[Check]:
    base = with_fields(random_splats(200, 7), means=torch.tensor([0.1, 0.0, -0.05]))
    yield from against_twin(base, ring())
    shape = torch.tensor([0.1, 0.05, 0.02])
    same = with_fields(base, scales=shape, quaternions=base.quaternions[0], opacities=0.3)
    yield from against_twin(same, ring(), label="one shape: ")


def _equal_depth(quick: bool) -> Iterator[Check]:
    base = random_splats(200, 8)
    means = base.means * torch.tensor([1.0, 1.0, 0.0]) + torch.tensor([0.0, 0.0, 2.0])
    yield from against_twin(with_fields(base, means=means), front_camera(64))
    # After a turn, depths differ by rounding only: the order is arbitrary, but alpha is the same.
    flat = with_fields(base, means=base.means * torch.tensor([1.0, 1.0, 0.0]), opacities=0.1)
    picture, truth = (render(flat, ring(), backend=b) for b in ("cpu", "reference"))
    error = (picture.alpha - truth.alpha).abs()
    yield Check("turned plane: alpha, max", float(error.max()), 2 / 255)


def _transparent(quick: bool) -> Iterator[Check]:
    base = with_fields(random_splats(100, 9), opacities=torch.tensor([0.0, 1e-3]).repeat(50))
    background = torch.tensor([0.2, 0.4, 0.6])
    picture = render(base, ring(), background)
    yield Check("difference from background", float((picture.color - background).abs().max()), 0)
    picture, grads = draw_and_differentiate(base, ring(), "cpu")
    yield Check("non-finite values", nonfinite(picture.depth, *grads.values()), 0)
    yield Check("gradient of nothing", max(float(g.abs().max()) for g in grads.values()), 0)


def _opaque(quick: bool) -> Iterator[Check]:
    base = with_fields(random_splats(400, 10, scale=0.2), opacities=1.0)
    yield from against_twin(base, ring(), RenderSettings(transmittance_min=0.0))
    yield from against_twin(base, ring(), label="early stop: ")
    picture = render(base, ring())
    yield Check("alpha above 1", float(picture.alpha.detach().max()) - 1, 0)


def _denormals(quick: bool) -> Iterator[Check]:
    base = random_splats(40, 11)
    tiny = with_fields(base, means=base.means * 1e-41, scales=1e-41, sh=base.sh * 1e-40)
    yield from against_twin(with_fields(tiny, opacities=0.5), ring(), gradient_limit=None)
    splats = leaves(base)
    picture = render(splats, ring())
    picture.color.backward(torch.full_like(picture.color, 1e-42))
    yield Check(
        "non-finite gradients of denormal ones",
        nonfinite(*(value.grad for _, value in splats.fields())),
        0,
    )


def _huge_values(quick: bool) -> Iterator[Check]:
    base = random_splats(60, 12)
    far = base.means.clone()
    far[:20] *= 10.0 ** torch.linspace(3, 37, 20)[:, None]
    yield from against_twin(
        with_fields(base, means=far), ring(), label="far: ", gradient_limit=None
    )
    bright = base.sh.clone()
    bright[:8] *= 1e12
    picture, grads = draw_and_differentiate(with_fields(base, sh=bright), ring(), "cpu")
    yield Check("bright: non-finite values", nonfinite(picture.color, *grads.values()), 0)


def _nonfinite_values(quick: bool) -> Iterator[Check]:
    base = random_splats(60, 13)
    broken = Splats(**{name: value.clone() for name, value in base.fields()})
    place = 0
    for _, value in broken.fields():
        for bad in (torch.nan, torch.inf, -torch.inf):
            value[place] = bad
            place += 1
    rest = base.select(torch.arange(60) >= place)
    drawn, expected = render(broken, ring()), render(rest, ring())
    yield Check(
        "difference from the others alone", float((drawn.color - expected.color).abs().max()), 0
    )
    from gscomplete.splats.filters import usable_rows

    keep, reasons = usable_rows(broken)
    yield Check("dropped without a reason", 60 - int(keep.sum()) - sum(reasons.values()), 0)
    yield Check("unusable rows not found", place - sum(reasons.values()), 0)


def _nan_upstream(quick: bool) -> Iterator[Check]:
    for name, where in (
        ("everywhere", slice(None)),
        ("one view", 0),
        ("one pixel", (0, 24, 24, 1)),
    ):
        splats = leaves(random_splats(300, 14, scale=0.1))
        picture = render(splats, ring())
        upstream = torch.zeros_like(picture.color)
        upstream[where] = torch.nan
        picture.color.backward(upstream)
        hidden = sum(not bool(torch.isnan(value.grad).any()) for _, value in splats.fields())
        yield Check(f"{name}: groups that hide it", hidden, 0)


def _none(quick: bool) -> Iterator[Check]:
    some = random_splats(5, 15)
    empty = some.select(torch.zeros(5, dtype=torch.bool))
    cases = [(empty, None), (empty, some), (some, empty), (empty, empty)]
    for new, frozen in cases:
        trainable = leaves(new)
        picture = render(trainable, ring(), frozen=frozen)
        picture.color.sum().backward()
        grads = [value.grad for _, value in trainable.fields()]
        label = f"{len(new)} new, {'no' if frozen is None else len(frozen)} frozen"
        yield Check(
            f"{label}: non-finite values", nonfinite(picture.color, picture.depth, *grads), 0
        )
        both = concatenate([new] if frozen is None else [frozen, new])
        truth = render(both, ring(), backend="reference")
        error = (picture.color.detach() - truth.color).abs().max()
        yield Check(f"{label}: colour", float(error), 1 / 255)
    views = ring()[0:0]
    yield Check("pictures of 0 views", len(render(some, views).color), 0)


def _float32(quick: bool) -> Iterator[Check]:
    for degree in (0, 3):
        base = random_splats(1000, 16 + degree, degree=degree)
        yield from against_twin(base, ring(64), label=f"SH degree {degree}: ")
    exact = render(base.to(dtype=torch.float64), ring(64))
    same = (exact.color - render(base, ring(64)).color).abs().max()
    yield Check("float64 splats: difference", float(same), 1e-6)


SPLAT_ROWS = (
    Row("needles", "60 splats of 0.5 x 5e-7 x 5e-7", _needles),
    Row("pancakes", "60 splats of 0.5 x 0.5 x 5e-7", _pancakes),
    Row("scales", "1e-8 to 1e3", _scales),
    Row("scales beyond", "1e-30 to 1e15, ratio 1e6", _beyond_scales),
    Row("opacities", "logits +/-inf, +/-90; 1/255, 0.999, 1e-42", _opacities),
    Row("quaternions", "lengths 0, 1e-30 to 1e30", _quaternions),
    Row("coincident", "200 splats at one point", _coincident),
    Row("equal depth", "200 splats in one plane", _equal_depth),
    Row("all transparent", "opacities 0 and 0.001", _transparent),
    Row("all opaque", "400 splats of opacity 1", _opaque),
    Row("denormals", "values of 1e-41, upstream gradients of 1e-42", _denormals),
    Row("huge values", "positions to 1e37, colours to 1e12", _huge_values),
    Row("non-finite values", "NaN, +inf, -inf in every field", _nonfinite_values),
    Row("NaN gradients", "NaN upstream of the renderer", _nan_upstream),
    Row("no splats", "0 new, 0 frozen, 0 views", _none),
    Row("float32", "1000 ordinary splats, SH 0 and 3", _float32),
)
"""Rows about splats."""
