"""What a row of the stress table is, and the comparison with the float64 twin.

Conventions
-----------
* A check passes when its value is at most its limit; NaN fails.
* Counts (non-finite values, lost splats, changed bytes) have the limit 0.
* Colour errors are absolute, gradient errors relative in the norm of a parameter group.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.render import Render, RenderSettings, render
from gscomplete.splats import Splats
from gscomplete.views import Cameras

COLOR_LIMIT = 1 / 255
"""An alpha within rounding of the threshold may count in one renderer and not in the other."""
MEAN_LIMIT = 1e-4
GRADIENT_LIMIT = 1e-3
LEAST_NORM = 1e-12
"""Gradients of a smaller norm are compared absolutely."""


@dataclass(frozen=True, slots=True)
class Check:
    """A measured number and the largest that passes."""

    what: str
    value: float
    limit: float

    @property
    def passed(self) -> bool:
        """Whether the value is within the limit."""
        return self.value <= self.limit

    @property
    def strain(self) -> float:
        """How near the limit the value is; infinite beyond it for limits of 0."""
        if math.isnan(self.value):
            return math.inf
        if self.limit == 0:
            return 0.0 if self.value <= 0 else math.inf
        return self.value / self.limit


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the table; ``run(quick)`` yields its checks."""

    name: str
    fed: str
    run: Callable[[bool], Iterator[Check]]


def leaves(splats: Splats) -> Splats:
    """Return a copy whose fields are trainable."""
    return Splats(**{name: value.clone().requires_grad_() for name, value in splats.fields()})


def nonfinite(*tensors: Tensor | None) -> int:
    """Count values that are not finite; a gradient that is missing counts as one."""
    return sum(1 if t is None else int((~torch.isfinite(t)).sum()) for t in tensors)


def draw_and_differentiate(
    splats: Splats, cameras: Cameras, backend: str, settings: RenderSettings | None = None
) -> tuple[Render, dict[str, Tensor]]:
    """Render, and return the gradients of fixed random weights times colour, alpha and depth."""
    trainable = leaves(splats)
    picture = render(trainable, cameras, backend=backend, settings=settings)  # type: ignore[arg-type]
    generator = torch.Generator().manual_seed(7)
    loss = torch.zeros((), dtype=picture.color.dtype)
    for part in (picture.color, picture.alpha, picture.depth / _typical(picture.depth)):
        weights = torch.randn(part.shape, generator=generator, dtype=torch.float64)
        loss = loss + (part * weights.to(part)).sum()
    loss.backward()
    missing = {name: value for name, value in trainable.fields() if value.grad is None}
    if missing:
        raise AssertionError(f"no gradient for {', '.join(missing)}")
    return picture, {name: value.grad for name, value in trainable.fields()}


def _detached(picture: Render) -> Render:
    """Return a picture without graph."""
    return Render(picture.color.detach(), picture.alpha.detach(), picture.depth.detach())


def _typical(depth: Tensor) -> float:
    """Return a constant that brings depths to about 1."""
    return float(depth.detach().abs().max().clamp_min(1e-30))


def against_twin(
    splats: Splats,
    cameras: Cameras,
    settings: RenderSettings | None = None,
    *,
    label: str = "",
    color_limit: float = COLOR_LIMIT,
    mean_limit: float = MEAN_LIMIT,
    gradient_limit: float | None = GRADIENT_LIMIT,
) -> Iterator[Check]:
    """Compare pictures and gradients of the CPU renderer with the float64 twin's.

    Args:
        splats: what is drawn.
        cameras: from where.
        settings: of the image formation.
        label: put before the names of the checks.
        color_limit: largest error of a pixel's colour or alpha.
        mean_limit: largest mean of these errors.
        gradient_limit: largest relative error of a group; None = gradients need only be finite.
    """
    picture, grads = draw_and_differentiate(splats, cameras, "cpu", settings)
    broken = nonfinite(picture.color, picture.alpha, picture.depth, *grads.values())
    yield Check(f"{label}non-finite values", broken, 0)
    truth, true_grads = draw_and_differentiate(splats, cameras, "reference", settings)
    picture, truth = _detached(picture), _detached(truth)
    errors = torch.cat(
        [
            (picture.color - truth.color).abs().flatten(),
            (picture.alpha - truth.alpha).abs().flatten(),
        ]
    )
    yield Check(f"{label}colour, max", float(errors.max()), color_limit)
    yield Check(f"{label}colour, mean", float(errors.mean()), mean_limit)
    far = float(truth.depth.max())
    if far > 0:
        depth = ((picture.depth - truth.depth).abs() * truth.alpha).mean() / far
        yield Check(f"{label}depth, mean", float(depth), mean_limit)
    if gradient_limit is not None:
        for name, true in true_grads.items():
            error = float((grads[name] - true).norm() / true.norm().clamp_min(LEAST_NORM))
            yield Check(f"{label}gradient of {name}", error, gradient_limit)
