"""Contact sheets and turntables.

Conventions
-----------
* Splats and cameras are in the object frame; pictures are 8-bit sRGB over one background.
* The background is light grey, so that neither white nor black objects vanish.
* Files are written atomically.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from PIL.PngImagePlugin import PngInfo
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.render import render
from gscomplete.splats import Splats
from gscomplete.util.atomic import atomic_path
from gscomplete.views import Cameras, ViewDistribution

LIGHT_GREY = (0.78, 0.78, 0.78)
"""Background of pictures made for people."""
ERROR_INK = (0.8, 0.05, 0.05)
"""Colour of large errors."""
_MARK = ("Software", "GSComplete")
"""Text in every PNG file."""
_ERROR_GAIN = 4.0
"""Differences of colours are drawn this much larger."""
_INK = (40, 40, 40)
_PAPER = (245, 245, 245)
_MARGIN_PX = 4
_MOST_TITLE_PX = 480
"""A title may make a sheet so wide, not wider."""
_LONGEST_TITLE = 400
"""Longer titles are cut before they are measured, letters."""
_FRAME_MS = 80
"""Time for which a picture is shown."""
_TURN_FRAMES, _TURN_PX = 36, 256
"""Pictures in one full turn, and their side."""
_TURN_QUALITY = 80
"""WebP quality, 1 to 100; other formats ignore it."""


def render_images(
    splats: Splats, cameras: Cameras, background: tuple[float, float, float] = LIGHT_GREY
) -> list[Image.Image]:
    """Render splats from every camera as pictures.

    Args:
        splats: N splats in the cameras' world frame.
        cameras: V cameras.
        background: colour in [0, 1].

    Returns:
        V pictures, 8 bits a channel.
    """
    with torch.no_grad():
        color = render(splats, cameras, splats.means.new_tensor(background)).color
    return [to_image(view) for view in color]


def to_image(color: Tensor) -> Image.Image:  # [H, W, 3] in [0, 1]
    """Turn colours into an 8-bit picture, rounding to nearest."""
    pixels: NDArray[np.uint8] = (
        (color.detach().cpu().clamp(0.0, 1.0) * 255.0 + 0.5).to(torch.uint8).numpy()
    )
    return Image.fromarray(pixels)


def errors_on(
    ours: Tensor,  # [H, W, 3]
    theirs: Tensor,  # [H, W, 3]
    mask: Tensor,  # [H, W]
) -> Tensor:  # [H, W]
    """Return how red differences are drawn: 0 = there is none, or P is not there; 1 = large."""
    return (_ERROR_GAIN * (ours - theirs).abs().mean(dim=-1) * mask).clamp(0, 1)


def error_picture(
    ours: Tensor,  # [H, W, 3]
    theirs: Tensor,  # [H, W, 3]
    mask: Tensor,  # [H, W]
) -> Image.Image:
    """Draw differences where P is: white = none, red = large; light grey where P is not."""
    error = errors_on(ours, theirs, mask)[..., None]
    inside = (1 - error) * torch.ones(3) + error * torch.tensor(ERROR_INK)
    weight = mask[..., None].clamp(0, 1)
    return to_image(weight * inside + (1 - weight) * torch.tensor(LIGHT_GREY))


def contact_sheet(
    rows: Sequence[Sequence[Image.Image]],
    *,
    row_labels: Sequence[str] = (),
    column_labels: Sequence[str] = (),
    title: str = "",
) -> Image.Image:
    """Lay pictures out in rows with labels above columns and at the left end of rows.

    Args:
        rows: pictures, row by row; rows may differ in length, pictures should not in size.
        row_labels: one per row, or none at all.
        column_labels: one per column, or none at all.
        title: one line above everything.

    Returns:
        One picture, white behind and between.

    Raises:
        ValueError: there is no picture, or the number of labels fits neither.
    """
    pictures = [picture for row in rows for picture in row]
    columns = max((len(row) for row in rows), default=0)
    if not pictures:
        raise ValueError("contact_sheet: expected at least one picture, found none")
    for name, labels, count in (
        ("row_labels", row_labels, len(rows)),
        ("column_labels", column_labels, columns),
    ):
        if len(labels) not in (0, count):
            raise ValueError(f"contact_sheet: {name}: expected {count}, found {len(labels)}")
    font = ImageFont.load_default(13)
    cell_width = max(picture.width for picture in pictures) + _MARGIN_PX
    cell_height = max(picture.height for picture in pictures) + _MARGIN_PX
    label_width = max((_text_width(label, font) + 8 for label in row_labels), default=0)
    left = _MARGIN_PX + label_width
    line = 20
    top = _MARGIN_PX + line * bool(title) + line * bool(column_labels)
    grid = left + columns * cell_width
    wanted = min(_text_width(title[:_LONGEST_TITLE], font) + 2 * _MARGIN_PX, _MOST_TITLE_PX)
    width = max(grid, wanted)
    title = _shortened(title, width - 2 * _MARGIN_PX, font)
    sheet = Image.new("RGB", (width, top + len(rows) * cell_height), _PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((_MARGIN_PX, _MARGIN_PX), title, _INK, font)
    for column, label in enumerate(column_labels):
        draw.text((left + column * cell_width, top - line), label, _INK, font)
    for row, images in enumerate(rows):
        y = top + row * cell_height
        if row_labels:
            draw.text((_MARGIN_PX, y + cell_height // 2 - 8), row_labels[row], _INK, font)
        for column, picture in enumerate(images):
            sheet.paste(picture, (left + column * cell_width, y))
    return sheet


def preview_sheet(
    partial: Splats,
    turntable: Sequence[Image.Image],
    views: ViewDistribution,
    *,
    title: str = "",
) -> Image.Image:
    """Show input and completion from the same six views, the input view c first.

    Args:
        partial: P in the object frame.
        turntable: pictures of O from evenly spaced views, c first (``draw_turntable``); their
            number is a multiple of six.
        views: V with the input view c.
        title: line above all, such as the prompt.

    Returns:
        Two rows of six pictures: input above completion.
    """
    cameras = views.preview_cameras(turntable[0].width)
    completed = turntable[:: len(turntable) // len(cameras)]
    offsets = [f"c + {60 * index}" if index else "c (input view)" for index in range(6)]
    return contact_sheet(
        [render_images(partial, cameras), completed],
        row_labels=["input", "completion"],
        column_labels=offsets,
        title=title,
    )


def save_image(image: Image.Image, path: Path) -> None:
    """Write a picture in the format of its suffix, replacing ``path`` in one step.

    Args:
        image: the picture.
        path: where to, such as ``preview.png``.

    Raises:
        UserError: the suffix names no picture format, or the folder cannot be written.
    """
    _require_format(path)
    text = PngInfo()
    text.add_text(*_MARK)
    with atomic_path(path) as temporary:
        if path.suffix.lower() == ".png":
            image.save(temporary, pnginfo=text)
        else:
            image.save(temporary)


def require_own_picture(path: Path) -> None:
    """Refuse to replace a picture of a name that the user did not give, unless we drew it.

    Args:
        path: a PNG file, which need not exist.

    Raises:
        UserError: it exists, and ``save_image`` did not write it.
    """
    if not path.exists():
        return
    name, value = _MARK
    try:
        with Image.open(path) as image:
            is_ours = image.info.get(name) == value
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        is_ours = False
    if not is_ours:
        raise UserError(
            f"{path}: would be replaced, but was not drawn by this program; move it away, or run "
            "this in another folder"
        )


def draw_turntable(splats: Splats, views: ViewDistribution) -> list[Image.Image]:
    """Draw one turn about the object, starting at the input view c.

    Args:
        splats: what to show, in the object frame.
        views: gives the start, elevation, distance and lens.

    Returns:
        Pictures from evenly spaced views.
    """
    return render_images(splats, views.ring(_TURN_FRAMES, _TURN_PX))


def save_turntable(frames: Sequence[Image.Image], path: Path) -> None:
    """Write the pictures of a turn as an endless animation.

    Args:
        frames: what ``draw_turntable`` returned.
        path: destination; WebP, GIF or animated PNG by its suffix.

    Raises:
        UserError: the suffix names no animated format, or the folder cannot be written.
    """
    if path.suffix.lower() not in (".webp", ".gif", ".png"):
        raise UserError(f"{path}: turntable: expected .webp, .gif or .png, found {path.suffix!r}")
    if path.suffix.lower() == ".webp":
        importlib.import_module("PIL.WebPImagePlugin")  # else Pillow loads all formats to find it
    with atomic_path(path) as temporary:
        frames[0].save(
            temporary,
            save_all=True,
            append_images=frames[1:],
            duration=_FRAME_MS,
            loop=0,
            quality=_TURN_QUALITY,
        )


def _require_format(path: Path) -> None:
    """Refuse a suffix that Pillow cannot write."""
    if path.suffix.lower() == ".png":
        return  # Pillow loads all formats to tell of any
    writable = Image.registered_extensions()
    if writable.get(path.suffix.lower()) not in Image.SAVE:
        raise UserError(f"{path}: expected a picture such as .png, found suffix {path.suffix!r}")


def _shortened(text: str, width_px: int, font: ImageFont.FreeTypeFont | ImageFont.ImageFont) -> str:
    """Return a text as one line that is no wider than ``width_px``, its end left out if need be."""
    line = " ".join(text[:_LONGEST_TITLE].split())
    if len(text) <= _LONGEST_TITLE and _text_width(line, font) <= width_px:
        return line
    while line and _text_width(line + "…", font) > width_px:
        line = line[:-1].rstrip()
    return line + "…"


def _text_width(text: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont) -> int:
    """Width of a line of text in pixels, rounded up."""
    return int(font.getlength(text)) + 1
