"""``gscomplete render``: pictures of a splat file."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from gscomplete.errors import UserError
from gscomplete.util.parse import parse_numbers, parse_view, require_positive

if TYPE_CHECKING:
    from torch import Tensor

    from gscomplete.views import ObjectFrame, UpAxis

_MOST_FOV_DEG = 80.0
_SHOWN = 1.6
"""Length through the frame's centre that a picture shows, in sizes of the frame."""


@dataclass(frozen=True)
class RenderOptions:
    """Render a splat file, a run's result or an object folder's partial object from given views.

    Example: gscomplete render runs/mug --views 0,15 90,15 --out pictures
    """

    file: Annotated[Path, tyro.conf.Positional]
    """Splat PLY, run folder or object folder."""
    out: Path = Path("render")
    """Folder for the pictures view_AZIMUTH_ELEVATION.png; existing ones are replaced."""
    views: tuple[str, ...] = ("0,15", "60,15", "120,15", "180,15", "240,15", "300,15")
    """Views as AZIMUTH,ELEVATION in degrees of the object frame, at least one."""
    up: str | None = None
    """Axis (such as -Y) or direction X,Y,Z of the file that points up; None = as its run or object
    folder says, else Z."""
    center: str | None = None
    """Centre of the object frame as X,Y,Z in file coordinates, with --object-size; None = as the
    run or object folder says, else the middle of the splats without floaters."""
    size: Annotated[float | None, tyro.conf.arg(name="object-size")] = None
    """Side of the object frame in file units, with --center; None = as the run or object folder
    says, else the splats' largest side without floaters. Pictures span 1.6 times this size."""
    size_px: int = 512
    """Width and height of the pictures in pixels."""
    fov: float = 40.0
    """Vertical field of view in degrees, at most 80; with more, the camera would be inside the
    object's box."""
    background: str = "1,1,1"
    """Colour behind the splats as R,G,B in 0 to 1."""
    channel: Literal["color", "alpha", "depth"] = "color"
    """What to draw; depth is scaled so that white is the nearest splat and black the farthest."""


def run(options: RenderOptions) -> int:
    """Render the views; return the exit code."""
    import numpy as np
    import torch
    from PIL import Image

    from gscomplete.render import render
    from gscomplete.splats.filters import reason_in_words, usable_rows
    from gscomplete.splats.formats.any_file import read_any_splats
    from gscomplete.splats.transform import transform_splats
    from gscomplete.util.atomic import atomic_path
    from gscomplete.views import ObjectFrame, orbit_cameras, radius_to_fit

    if not 1 <= options.size_px <= 8192:
        raise UserError(f"--size-px: expected 1 to 8192, found {options.size_px}")
    if not 1 <= options.fov <= _MOST_FOV_DEG:
        raise UserError(f"--fov: expected 1 to {_MOST_FOV_DEG:g} degrees, found {options.fov:g}")
    if not options.views:
        raise UserError("--views: expected at least one AZIMUTH,ELEVATION, found none")
    background = parse_numbers(options.background, 3, "--background", "R,G,B") or [1.0, 1.0, 1.0]
    if not all(0 <= value <= 1 for value in background):
        raise UserError(f"--background: expected 0 to 1 each, found {options.background}")
    angles = [parse_view(view, "--views") for view in options.views]
    from gscomplete.folders import drawable_of
    from gscomplete.views import parse_up

    drawable = drawable_of(options.file)
    up = parse_up(options.up) or (drawable.frame.up if drawable.frame is not None else "Z")
    given = _given_frame(options, up)
    if given is None and drawable.frame is not None and drawable.frame.up == up:
        given = drawable.frame
    splats = read_any_splats(drawable.file).splats
    usable, left_out = usable_rows(splats)
    if not bool(usable.any()):
        raise UserError(f"{drawable.file}: expected splats that can be drawn, found none")
    for reason, count in left_out.items():
        print(f"{count:,} splats not drawn: {reason_in_words(reason)}", file=sys.stderr)
    splats = splats.select(usable)
    frame = given or ObjectFrame.without_floaters(splats, up)
    outside = frame.count_outside(splats, _SHOWN / 2)
    if outside:
        print(f"{outside:,} splats lie outside the frame that is shown", file=sys.stderr)
    cameras = orbit_cameras(
        torch.tensor([view[0] for view in angles if view]),
        torch.tensor([view[1] for view in angles if view]),
        radius=radius_to_fit(_SHOWN, options.fov),
        fov_deg=options.fov,
        size_px=options.size_px,
    )
    placed = transform_splats(splats, frame.object_from_file)
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{options.out}: cannot create the folder: {error.strerror}") from error

    def drawn() -> Iterator[Tensor]:
        """Draw one view at a time: large ones fill the memory."""
        for index in range(len(cameras)):
            with torch.no_grad():
                view = render(placed, cameras[[index]], torch.tensor(background))
            yield getattr(view, options.channel)[0]

    pictures = _near_is_white(torch.stack([*drawn()])) if options.channel == "depth" else drawn()
    for view, picture in zip(options.views, pictures, strict=True):
        path = options.out / f"view_{view.replace(',', '_')}.png"
        values = (picture.clamp(0, 1) * 255).round().numpy().astype(np.uint8)
        with atomic_path(path) as temporary:
            Image.fromarray(values).save(temporary, format="PNG")
        print(path)
    return 0


def _given_frame(options: RenderOptions, up: UpAxis) -> ObjectFrame | None:
    """Return the object frame that the user gives.

    Raises:
        UserError: centre or size has the wrong form, or one comes without the other.
    """
    from gscomplete.views import ObjectFrame

    center = parse_numbers(options.center, 3, "--center", "X,Y,Z")
    require_positive(options.size, "--object-size")
    if center is None and options.size is None:
        return None
    if center is None or options.size is None:
        raise UserError("--center, --object-size: expected both or none, found one")
    return ObjectFrame(up, (center[0], center[1], center[2]), options.size)


def _near_is_white(depth: Tensor) -> Tensor:  # [V, H, W]
    """Scale depths to [0, 1], 1 for the nearest; pixels that show nothing are 0."""
    seen = depth > 0
    if not bool(seen.any()):
        return depth
    near, far = depth[seen].min(), depth[seen].max()
    return (1.0 - (depth - near) / (far - near).clamp_min(1e-9)) * seen
