"""The denoiser's conditioning: the words of the prompt, and a known shape of its noun.

To a denoiser of this size words alone say little. A known shape of the noun, drawn without colours
from the ring's cameras, tells it where surfaces are, and the words tell it their colours.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from gscomplete.priors.base import FourViews
from gscomplete.priors.embedded.inputs import shape_map
from gscomplete.priors.embedded.model import SHAPE_CHANNELS, VIEWS
from gscomplete.render import render
from gscomplete.shape.bank.cell_splats import cell_splats
from gscomplete.shape.bank.fit import FittedShape
from gscomplete.shape.bank.pose import surface_centers
from gscomplete.shape.bank.store import read_bank
from gscomplete.splats import Splats
from gscomplete.util.arrays import Float64Array


@dataclass(frozen=True, slots=True)
class EmbeddedConditioning:
    """Token ids of a prompt and of what guidance leads away from, and a known shape."""

    tokens: Tensor  # [L]
    negative_tokens: Tensor  # [L]
    shape_tokens: Tensor  # [L] the prompt in the words of the shape network
    report: tuple[str, ...]
    prompt: str
    shape: Splats | None = None
    """What is known of the object's surface, object frame; colours do not count."""

    @property
    def has_text(self) -> bool:
        """Whether the prompt says anything that the negative prompt does not."""
        return not torch.equal(self.tokens, self.negative_tokens)

    def with_surface(self, centers: Float64Array, scale: float, note: str) -> EmbeddedConditioning:
        """Return the same with a known surface.

        Args:
            centers: [N, 3] of the cells that it passes, object frame.
            scale: of the bank's cells.
            note: where it comes from, for the user.
        """
        shape = cell_splats(centers, scale)
        return dataclasses.replace(self, shape=shape, report=(*self.report, note))

    def shape_map(
        self, views: FourViews, radius: float, size_px: int
    ) -> Tensor:  # [4, 2, size, size]
        """Return what the cameras of a ring see of the shape; zeros where none is known."""
        if self.shape is None:
            return torch.zeros(VIEWS, SHAPE_CHANNELS, size_px, size_px)
        seen = render(self.shape, views.cameras.to("cpu"))
        return shape_map(seen.alpha, seen.depth, radius, size_px)


def about_partial(given: EmbeddedConditioning, fitted: FittedShape) -> EmbeddedConditioning:
    """Return the conditioning with a known shape in the place that suits P."""
    shape = fitted.name.id
    note = f"prompt: the prior sees the known shape {shape}, fitted to P"
    scale = 1 / float(fitted.pose.scales.mean())
    return given.with_surface(fitted.points, scale, note)


def upright(given: EmbeddedConditioning, bank: Path, index: int) -> EmbeddedConditioning:
    """Return the conditioning with a shape of the bank as it stands in its own frame."""
    shapes = read_bank(bank)
    note = f"prompt: the prior sees the known shape {shapes.names[index].id}"
    return given.with_surface(surface_centers(shapes.surface(index)), 1.0, note)
