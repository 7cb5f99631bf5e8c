"""What other systems are given: ``python -m recipes.baselines.views --dataset DIR --out DIR``.

The paper compares with single-view systems, which see the input view c, and with a multi-view one,
which sees c and the views at azimuth offsets of 90 and 270 degrees, each inpainted (SDXL) under a
mask that comes from P's alpha. For every object, ``OUT/ID`` gets

* ``view_000.png``, ``view_090.png``, ``view_270.png``: P, straight RGB with alpha;
* ``mask_OFFSET.png``: white where the painter has to paint, black where P is;
* ``views.json``: the cameras (OpenCV axes, in the object frame, with the similarity that takes P's
  file there), the prompt, and the files.

Pictures painted by another program come back as ``inpainted_OFFSET.png`` in that folder, of the
same view at any size, opaque or with alpha. ``--paint`` paints them with SDXL by way of diffusers,
where its weights are on the machine. P's own pixels are put back into the painted pictures
(``given_OFFSET.png``), so that a system sees P as it is. A multi-view system reconstructs the
object from these, as in the paper, and ``recipes.baselines.enter`` takes its result.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from gscomplete.errors import UserError
from gscomplete.evaluate.subject import objects_of
from gscomplete.folders import ObjectFolder
from gscomplete.render import render
from gscomplete.splats import read_splats, usable_rows
from gscomplete.splats.transform import transform_splats
from gscomplete.util import jsonio
from gscomplete.util.atomic import atomic_path
from gscomplete.views import Cameras
from recipes.entry_point import start

SCHEMA = "gscomplete.baseline-views"
OFFSETS_DEG = (0, 90, 270)
"""The paper's: from 180 degrees what there is of the object is hidden."""
VIEWS_FILE = "views.json"
_SOLID = 0.5
"""Alpha of P above which a pixel is P's and not painted."""
_WHITE = 255
PAINTER = "stabilityai/stable-diffusion-xl-base-1.0"
"""Weights of the paper's inpainting."""

Painter = Callable[[Image.Image, Image.Image, str], Image.Image]
"""Paints a picture where the mask is white, after a prompt."""


@dataclass(frozen=True)
class Options:
    """Write, paint and take back the views that other systems are given."""

    dataset: Path
    """Folder of object folders."""
    out: Path
    """Folder for a folder of views per object; inpainted pictures in it are kept."""
    size_px: int = 1024
    """Side of the pictures."""
    paint: bool = False
    """Inpaint pictures that are not there yet with SDXL."""
    weights: str = PAINTER
    """With --paint: folder or name of the weights; nothing is downloaded."""
    seed: int = 0
    """With --paint: seed of its noise."""


def cameras_of(known: ObjectFolder, size_px: int) -> Cameras:
    """Return the cameras of ``OFFSETS_DEG`` in the object frame."""
    views = known.views
    azimuths = views.azimuth_deg + np.array(OFFSETS_DEG, dtype=np.float64)
    return views.cameras((azimuths, np.full(len(azimuths), views.elevation_deg)), size_px)


def export(known: ObjectFolder, folder: Path, size_px: int) -> dict[str, Any]:
    """Write P's views of an object, their masks and cameras; return what ``views.json`` says.

    Raises:
        UserError: P cannot be read, or the folder not be written.
    """
    splats = read_splats(known.partial).splats
    partial = transform_splats(splats.select(usable_rows(splats)[0]), known.frame.object_from_file)
    cameras = cameras_of(known, size_px)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{folder}: cannot create the folder: {error.strerror}") from error
    rows = []
    for index, offset in enumerate(OFFSETS_DEG):
        with torch.no_grad():
            seen = render(partial, cameras[index])
        alpha = seen.alpha[0].clamp(0, 1)
        straight = (seen.color[0] / alpha[..., None].clamp_min(1e-6)).clamp(0, 1)
        pixels = torch.cat([straight, alpha[..., None]], dim=-1)
        _save(Image.fromarray(_bytes(pixels), "RGBA"), folder / view_file(offset))
        _save(Image.fromarray(_bytes((alpha < _SOLID).float())), folder / mask_file(offset))
        pose = cameras.camera_from_world[index].double()
        rows.append(
            {
                "azimuth_offset_deg": offset,
                "image": view_file(offset),
                "mask": mask_file(offset),
                "inpainted": inpainted_file(offset),
                "camera_from_object": pose.tolist(),
                "object_from_file": known.frame.object_from_file.to_json(),
                "focal_px": cameras.focal_px[index].tolist(),
                "center_px": cameras.center_px[index].tolist(),
                "width": cameras.width,
                "height": cameras.height,
            }
        )
    content = {
        "schema": SCHEMA,
        "version": 1,
        "object": known.id,
        "prompt": known.prompt,
        "views": rows,
    }
    jsonio.write_json(folder / VIEWS_FILE, content)
    return content


def take_back(folder: Path) -> list[Path]:
    """Put P's pixels into what was painted; return the pictures for a multi-view system.

    Raises:
        UserError: a picture is damaged or shows another view.
    """
    given = []
    for offset in OFFSETS_DEG:
        path = folder / inpainted_file(offset)
        if not path.is_file():
            continue
        view = _read(folder / view_file(offset), "RGBA")
        painted = _read(path, "RGBA")
        if painted.width * view.height != painted.height * view.width:
            raise UserError(
                f"{path}: expected a picture of {view.width} x {view.height} or its shape, found "
                f"{painted.width} x {painted.height}"
            )
        painted = painted.resize(view.size, Image.Resampling.LANCZOS)
        painted.alpha_composite(view)
        target = folder / f"given_{offset:03d}.png"
        _save(painted, target)
        given.append(target)
    return given


def paint(folder: Path, prompt: str, painter: Painter) -> None:
    """Paint the views of an object that have not come back."""
    for offset in OFFSETS_DEG:
        target = folder / inpainted_file(offset)
        if target.is_file():
            continue
        view = _read(folder / view_file(offset), "RGBA")
        ground = Image.new("RGBA", view.size, (_WHITE,) * 4)
        ground.alpha_composite(view)
        mask = _read(folder / mask_file(offset), "L")
        _save(painter(ground.convert("RGB"), mask, prompt).resize(view.size), target)


def sdxl_painter(weights: str, seed: int) -> Painter:
    """Return SDXL's inpainting by way of diffusers.

    Raises:
        UserError: diffusers or the weights are not on the machine.
    """
    try:
        import diffusers

        pipeline = diffusers.AutoPipelineForInpainting.from_pretrained(
            weights, local_files_only=True
        )
    except ImportError as error:
        raise UserError(f"--paint: unavailable: it needs diffusers ({error})") from error
    except (OSError, ValueError) as error:
        first = str(error).strip().splitlines()[0]
        raise UserError(
            f"--paint: unavailable: the weights {weights} are not on this machine ({first})"
        ) from error
    device = "cuda" if torch.cuda.is_available() else "cpu"
    pipeline = pipeline.to(device)

    def painter(image: Image.Image, mask: Image.Image, prompt: str) -> Image.Image:
        generator = torch.Generator("cpu").manual_seed(seed)
        found = pipeline(
            prompt=prompt,
            image=image,
            mask_image=mask,
            width=image.width,
            height=image.height,
            generator=generator,
        )
        picture: Image.Image = found.images[0]
        return picture

    return painter


def view_file(offset_deg: int) -> str:
    """Return the name of P's picture."""
    return f"view_{offset_deg:03d}.png"


def mask_file(offset_deg: int) -> str:
    """Return the name of the mask of what is to be painted."""
    return f"mask_{offset_deg:03d}.png"


def inpainted_file(offset_deg: int) -> str:
    """Return the name that a painted picture comes back under."""
    return f"inpainted_{offset_deg:03d}.png"


def main(options: Options) -> None:
    """Export, paint if asked to, and take back."""
    if not 32 <= options.size_px <= 4096:
        raise UserError(f"--size-px: expected 32 to 4096, found {options.size_px}")
    painter = sdxl_painter(options.weights, options.seed) if options.paint else None
    for known in objects_of(options.dataset):
        folder = options.out / known.id
        export(known, folder, options.size_px)
        if painter is not None:
            paint(folder, known.prompt, painter)
        count = len(take_back(folder))
        back = f", {count} inpainted came back" if count else ""
        sys.stdout.write(f"{known.id}: {len(OFFSETS_DEG)} views{back}\n")


def _bytes(values: torch.Tensor) -> np.ndarray:
    rounded: np.ndarray = (values * 255 + 0.5).to(torch.uint8).numpy()
    return rounded


def _read(path: Path, mode: str) -> Image.Image:
    try:
        with Image.open(path) as picture:
            return picture.convert(mode)
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: expected a picture: {error}") from error


def _save(picture: Image.Image, path: Path) -> None:
    with atomic_path(path) as temporary:
        picture.save(temporary, format="PNG")


if __name__ == "__main__":
    start(main, Options, __doc__)
