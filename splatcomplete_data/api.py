"""The data side from Python: sources to splats, and complete splats to parts.

Each function does what the command of its name does without writing an object folder; the modules
named there have the knobs. Splats are in the source's own frame and units unless said otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import torch

from gscomplete.errors import UserError, naming
from gscomplete.framing.decide import FramingRequest, frame_about
from gscomplete.splats import SplatFile, Splats, load_splats
from gscomplete.util.device import choose_device, plain_torch
from gscomplete.views import UpAxis
from splatcomplete_data.cuts.boxes import inside_boxes, parse_box
from splatcomplete_data.cuts.named import apply_cuts, parse_cut


@plain_torch()
def mesh_to_splats(path: str | Path, count: int = 100_000, *, seed: int = 0) -> Splats:
    """Cover a mesh with flat splats (``mesh.convert``).

    Args:
        path: OBJ, glTF, PLY, STL, DAE and what else trimesh reads.
        count: about how many splats.
        seed: of the sampling.

    Returns:
        Splats in the file's axes and units.

    Raises:
        UserError: the mesh cannot be read or has no surface.
    """
    from splatcomplete_data.mesh.convert import OUTLINE_PX, ConvertSettings, convert_mesh
    from splatcomplete_data.mesh.files.load import load_mesh

    settings = ConvertSettings(outline_px=OUTLINE_PX, seed=seed)
    mesh = load_mesh(Path(path))
    with naming(path):
        return convert_mesh(mesh, count, settings=settings).splats


@plain_torch()
def depth_to_splats(
    image: str | Path | None, depth: str | Path, *, fov_deg: float | None = None
) -> Splats:
    """Turn a photo and its depth into splats (paper, section 4, Singleview).

    Args:
        image: the photo; None = the one in the depth file.
        depth: PNG, NPY, EXR, or Depth Anything 3's NPZ.
        fov_deg: horizontal field of view; None = the file says it.

    Returns:
        Splats in the camera's frame (x right, y down, z forward; up is -Y).

    Raises:
        UserError: a file cannot be read, or nothing tells the intrinsics.
    """
    from splatcomplete_data.scan.make import PartSettings, make_part
    from splatcomplete_data.singleview.load import SingleViewSettings, load_single_view

    settings = SingleViewSettings(fov_deg=fov_deg)
    view = load_single_view(None if image is None else Path(image), Path(depth), settings)
    return make_part(view.cloud, PartSettings(), str(depth)).splats


@plain_torch()
def scan_to_splats(path: str | Path, *, spacing: float | None = None) -> Splats:
    """Turn a scan's points into round splats of one size (paper, section 4, LiDAR).

    Args:
        path: PCD, PLY, LAS, LAZ, text, or a mesh to sample.
        spacing: thin to one point per cube of this side, file units; None = keep all.

    Returns:
        Splats in the file's axes; far-off coordinates are moved to the origin.

    Raises:
        UserError: the file cannot be read or holds no finite point.
    """
    from splatcomplete_data.scan.make import PartSettings, make_part
    from splatcomplete_data.scan.read import read_scan

    return make_part(read_scan(Path(path)).cloud, PartSettings(spacing=spacing), str(path)).splats


@plain_torch()
def reconstruct(
    images: str | Path,
    out: str | Path,
    *,
    steps: int | None = None,
    device: str = "cpu",
    on_step: Callable[[object], None] | None = None,
) -> Splats:
    """Train splats from photos (paper, section 4, Multiview): poses are read or found by COLMAP.

    Args:
        images: a folder of photos, a COLMAP model, or a ``transforms.json``.
        out: capture folder to write; must be new or empty.
        steps: optimiser steps; None = the default number.
        device: where to train: ``cpu``, ``cuda``, ``cuda:N`` or ``auto``.
        on_step: called after every step.

    Returns:
        The scene's splats, levelled: z up.

    Raises:
        UserError: no poses can be had, a file is wrong, or there is no such device.
    """
    from splatcomplete_data.multiview import reconstruct as capture
    from splatcomplete_data.multiview.training.settings import TrainingSettings

    if steps is not None and steps < 1:
        raise UserError(f"steps: expected at least 1, found {steps}")
    chosen = choose_device(device)
    training = TrainingSettings() if steps is None else TrainingSettings(steps=steps)
    request = capture.Request(Path(images), Path(out), training=training)
    run = capture.prepare(request, chosen)
    capture.execute(run, on_step or (lambda report: None))
    return load_splats(Path(out) / "splats.ply")


@plain_torch()
def crop(splats: Splats, boxes: Sequence[str]) -> Splats:
    """Keep what boxes keep and do not remove.

    Args:
        splats: in the file frame.
        boxes: as ``--box`` takes them: ``[keep:|remove:]CX,CY,CZ,HX,HY,HZ[,QW,QX,QY,QZ]``, file
            coordinates and half sides.

    Returns:
        The splats that are left, file frame, as they were.

    Raises:
        UserError: there are no splats, a box has another form, or nothing is left.
    """
    _require_splats(splats)
    parsed = [parse_box(text) for text in _texts(boxes, "boxes")]
    inside = torch.from_numpy(inside_boxes(splats.as_read().means.numpy(), parsed))
    kept = splats.select(inside.to(splats.means.device))
    if not len(kept):
        raise UserError(f"crop: expected splats inside, found none of {len(splats):,}")
    return kept


@plain_torch()
def cut(splats: Splats, cuts: Sequence[str], *, up: UpAxis = "Z") -> Splats:
    """Cut a part out of a complete object.

    Args:
        splats: the complete object, file frame.
        cuts: as ``--cut`` takes them, in its object frame: ``plane:AZIMUTH[,OFFSET]``,
            ``box:X0,Y0,Z0,X1,Y1,Z1``, ``scan:AZ/EL,...``.
        up: axis of the file that points up.

    Returns:
        The part, file frame: those of the splats that every cut keeps, as they were.

    Raises:
        UserError: there are no splats, ``up`` is no direction, or a cut has another form, or keeps
            nothing or everything.
    """
    _require_splats(splats)
    parsed = [parse_cut(text) for text in _texts(cuts, "cuts")]
    frame = frame_about(splats.as_read(), FramingRequest(up))
    return apply_cuts(splats, frame, parsed, (), "splats")[0]


def _require_splats(splats: Splats) -> None:
    """Refuse what is no splats, or none.

    Raises:
        UserError: it is something else, or holds no splat.
    """
    if not isinstance(splats, Splats):
        hint = " (its .splats are meant)" if isinstance(splats, SplatFile) else ""
        raise UserError(f"splats: expected splats, found {type(splats).__name__}{hint}")
    if not len(splats):
        raise UserError("splats: expected at least one splat, found none")


def _texts(values: Sequence[str], name: str) -> Sequence[str]:
    """Return texts of an argument.

    Raises:
        UserError: it is one text alone, or holds something else.
    """
    if isinstance(values, list | tuple) and all(isinstance(value, str) for value in values):
        return values
    raise UserError(f"{name}: expected a list of texts, found {values!r}")
