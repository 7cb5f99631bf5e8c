"""What the data side adds to ``gscomplete.framing``: source coordinates, truths, unknown axes."""

from __future__ import annotations

import dataclasses

import torch

from gscomplete.errors import UserError
from gscomplete.framing.decide import Framing, FramingRequest
from gscomplete.framing.input_view import refine_input_view
from gscomplete.splats import Similarity, Splats, transform_splats
from gscomplete.views import ObjectFrame, UpAxis, up_rotation

SPLAT_FILE_UP: UpAxis = "-Y"
"""What points up in a splat file that nothing more is known of, as in most trained ones."""
UP_ASSUMED = "up axis assumed to be -Y, as no cameras are known (--up gives another)"
"""Note of an object whose up axis that decided."""


def y_up_turn(up: UpAxis) -> Similarity | None:
    """Return the turn from a splat file's axes to y up, as glTF, USD and SPZ have it.

    Args:
        up: what points up in the file.

    Returns:
        The turn; None = it is that of a format's own for ``SPLAT_FILE_UP``.
    """
    if up == SPLAT_FILE_UP:
        return None
    y_up = torch.tensor([[1, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=torch.float64) @ up_rotation(up)
    return Similarity(1.0, y_up, torch.zeros(3))


def moved_center(request: FramingRequest, file_from_source: Similarity) -> FramingRequest:
    """Take the centre, where one is given, from the source's frame to the file's."""
    if request.center_file is None:
        return request
    center = torch.tensor(request.center_file, dtype=torch.float64)
    x, y, z = file_from_source.apply(center).tolist()
    return dataclasses.replace(request, center_file=(x, y, z))


def seen_past_truth(decided: Framing, partial: Splats | None, complete: Splats | None) -> Framing:
    """Return a framing from whose V the complete object does not hide P, where it is known.

    A completion keeps P's appearance from V, so the truth has to leave P in sight from there.

    Args:
        decided: by P alone.
        partial: P in the file frame; None = there is none.
        complete: the complete object, file frame; None = not known.
    """
    if partial is None or complete is None:
        return decided
    to_object = decided.frame.object_from_file
    part, truth = (transform_splats(splats, to_object) for splats in (partial, complete))
    views = refine_input_view(part, truth, decided.views).views
    if views == decided.views:
        return decided
    note = (
        f"input view {views.azimuth_deg:g},{views.elevation_deg:g}: from the one guessed by P "
        "alone, the complete object hides P (--view gives another)"
    )
    return dataclasses.replace(decided, views=views, notes=(*decided.notes, note))


def require_touching(
    frame: ObjectFrame, part: Splats, file_from_source: Similarity | None = None
) -> None:
    """Refuse a frame that the user gave and in whose box no splat of the part lies.

    Args:
        frame: the frame.
        part: the splats; those that are not finite do not count.
        file_from_source: the error names coordinates of the source's frame; None = the file's.

    Raises:
        UserError: the box, larger by a splat's size on every side, holds no splat.
    """
    means = part.means.double()
    means = means[torch.isfinite(means).all(dim=1)]
    reach = 0.5 + part.typical_size / frame.size_file
    if len(means) == 0 or bool((frame.object_from_file.apply(means).abs() <= reach).all(1).any()):
        return
    center = torch.tensor(frame.center_file, dtype=torch.float64)
    if file_from_source is not None:
        back = file_from_source.inverse()
        means, center = back.apply(means), back.apply(center)
    low, high, middle = (
        ",".join(f"{value:.9g}" for value in point.tolist())
        for point in (means.amin(dim=0), means.amax(dim=0), center)
    )
    raise UserError(
        f"--center, --object-size: expected a box that holds some of the part, which spans {low} "
        f"to {high}; found the box of side {frame.size_file:.9g} around {middle}"
    )
