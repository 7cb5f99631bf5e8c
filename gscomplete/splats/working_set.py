"""Which splats of P take part in the optimisation. The output always has all of them.

Splats that cannot be drawn (not finite, far too large) are left out, and so are a few far outside
the object, which would pass for parts of it. Strays beside its surface and the table that it stands
on are drawn, as they are part of P's appearance, but nothing is guessed from them. Of very large
inputs an even choice is drawn, with widths grown to match: at the resolutions that priors see,
millions of splats cost time and change nothing.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.splats import Splats
from gscomplete.splats.filters import in_words, reason_in_words, usable_rows
from gscomplete.splats.geometry.table import table_rows
from gscomplete.splats.strays import stray_rows
from gscomplete.splats.thinning import thinned
from gscomplete.splats.transform import Similarity
from gscomplete.util.randomness import generator_for

_FAR = 1.0
"""Splats farther than this from the object frame's origin along any axis are far outside, object
sizes; it is twice as far as the frame's box reaches."""
_MOST_FAR = 0.02
"""If a larger share is so far away, they are parts of P, and all splats take part."""


@dataclass(frozen=True, slots=True)
class WorkingSet:
    """The splats of P that are drawn, and what happened to the others."""

    splats: Splats
    """What is drawn, N splats."""
    is_stray: Tensor  # [N] bool floats beside the object's surface
    is_table: Tensor  # [N] bool belongs to what the object stands on
    total: int
    """Splats in the file."""
    unusable: dict[str, int]
    """How many rows are left out for each reason: those of ``usable_rows`` for rows that cannot be
    drawn, and ``far_outside_the_object``."""
    thinned: int
    """Splats left out because there were more than the limit."""

    @property
    def heeded(self) -> Splats:
        """What guesses are made from: all but strays and table."""
        left_out = self.is_stray | self.is_table
        return self.splats.select(~left_out) if bool(left_out.any()) else self.splats

    @property
    def stands_for(self) -> str:
        """Say in words which splats are measured and drawn: all of P, or a choice of them."""
        if not self.thinned:
            return "P"
        return f"{len(self.splats):,} splats that represent P's {self.total:,}"

    @property
    def summary(self) -> str:
        """Describe the choice in one line."""
        parts = [f"{len(self.splats):,} of {self.total:,} splats of P are used"]
        parts += [
            f"{count:,} left out ({reason_in_words(reason)})"
            for reason, count in self.unusable.items()
        ]
        strays, table = int(self.is_stray.sum()), int(self.is_table.sum())
        if strays:
            parts.append(f"nothing is guessed from {strays:,} strays beside the surface")
        if table:
            parts.append(f"nothing is guessed from {table:,} splats of what P stands on")
        if self.thinned:
            parts.append(f"{self.thinned:,} thinned out, the others enlarged to match")
        return "; ".join(parts)


def working_set(
    partial: Splats,
    limit: int | None,
    name: str,
    z_up_from_file: Tensor | None = None,  # [3, 3] rotation
) -> WorkingSet:
    """Choose the splats of P that take part.

    Args:
        partial: P as read.
        limit: most splats to draw; None = all.
        name: what errors call P: its file, or "P".
        z_up_from_file: takes file axes to z-up ones; None = neither strays nor table are looked
            for.

    Raises:
        UserError: no splat can be drawn.
    """
    usable, reasons = usable_rows(partial)
    if not bool(usable.any()):
        raise UserError(
            f"{name}: expected at least one splat that can be drawn, found none of "
            f"{len(partial)} ({in_words(reasons) or 'no splats'})"
        )
    splats = partial if bool(usable.all()) else partial.select(usable)
    thinned_out = 0
    if limit is not None and len(splats) > limit:
        thinned_out = len(splats) - limit
        splats = thinned(splats, limit, generator_for(0, 0, "working set"))
    is_stray = torch.zeros(len(splats), dtype=torch.bool, device=splats.means.device)
    is_table = torch.zeros_like(is_stray)
    if z_up_from_file is not None:
        is_stray = stray_rows(splats)
        points = splats.means[~is_stray].detach().double().cpu() @ z_up_from_file.T
        is_table[~is_stray] = torch.from_numpy(table_rows(points.numpy())).to(is_table.device)
    return WorkingSet(splats, is_stray, is_table, len(partial), reasons, thinned_out)


def without_far(working: WorkingSet, object_from_file: Similarity) -> WorkingSet:
    """Leave out the few splats that lie far outside the object frame's box."""
    places = object_from_file.apply(working.splats.means)
    is_far = places.abs().amax(dim=1) > _FAR
    count = int(is_far.sum())
    if not 0 < count <= _MOST_FAR * len(is_far):
        return working
    return dataclasses.replace(
        working,
        splats=working.splats.select(~is_far),
        is_stray=working.is_stray[~is_far],
        is_table=working.is_table[~is_far],
        unusable={**working.unusable, "far_outside_the_object": count},
    )
