"""``splatcomplete-data mesh``: a mesh file to splats, complete and part."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from gscomplete.errors import UserError, naming
from splatcomplete_data.cli.common import (
    ObjectDraft,
    ObjectOptions,
    StageCallback,
    check_out,
    ignore_stage,
    report_object,
    stages,
    store_object,
)

if TYPE_CHECKING:
    from gscomplete.splats import Splats
    from splatcomplete_data.objects import StepRecord


@dataclass(frozen=True, kw_only=True)
class MeshOptions(ObjectOptions):
    """Turn a mesh into flat splats on its surface.

    Writes complete.ply, and partial.ply if --cut is given. Unless --up says otherwise, up is Y for
    glTF and GLB, as the file says for DAE (Y if it says nothing), else Z. The file's own axes and
    units are kept in any case.

    Example: splatcomplete-data mesh duck.glb --count 100000 --cut plane:90 --out duck
    """

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """GLB, glTF, OBJ, PLY, STL, DAE or OFF."""
    count: int | None = None
    """Approximate number of splats; None = 100,000, unless --spacing is given."""
    spacing: float | None = None
    """Side of the square of surface that each splat covers, in file units, instead of --count."""
    mode: Literal["cells", "grid", "random", "poisson"] = "cells"
    """cells: cut every triangle into equal cells. grid: mesh2splat's density, one splat per grid
    cell. random: uniform random points with round splats, for comparison. poisson: round discs at
    blue noise (Poisson disks, pymeshlab), for even coverage without rows."""
    repair: bool = False
    """First merge duplicate vertices, drop null and duplicate faces and orient the others
    (pymeshlab); each change is counted."""
    sigma: float = 0.5
    """Tangential standard deviation over the cell's side; below 0.45 there are visible holes."""
    outline_px: float | None = None
    """Size of the object, in pixels, at which outlines are to be exact. 3DGS's blur widens
    outlines, so splats lie half such a pixel below the surface, at most 0.3 spacings; 0 leaves them
    on it. None = 512, or 0 with a scan: cut, which measures surfaces. Only for --mode cells."""
    cut: tuple[str, ...] = ()
    """Parts to keep for partial.ply: plane:AZIMUTH[,OFFSET], box:LX,LY,LZ,HX,HY,HZ (object frame)
    or scan:AZ/EL[,AZ/EL...]."""
    texture: Path | None = None
    """Texture for a mesh whose file lacks its own."""
    allow_outside: Path | None = None
    """Another folder from which files named by the mesh (textures, materials, buffers) may be read;
    None = only the mesh's own folder."""
    gltf_colors: Literal["linear", "srgb"] = "linear"
    """srgb for glTF files whose exporter wrote colour factors in sRGB."""
    light: bool = False
    """Bake soft light from above into the colours, as in a photo; recorded."""
    seed: int = 0
    """Seed of the sampling."""


def run(options: MeshOptions) -> int:
    """Convert the mesh; return the exit code."""
    check_out(options, options.file)
    with stages("mesh") as enter:
        made = make(options, enter)
        enter("writing the object", 0.6)
        record = store_object(options, made)
    return report_object(options, made, record)


def make(options: MeshOptions, enter: StageCallback = ignore_stage) -> ObjectDraft:
    """Convert the mesh and cut the part.

    Args:
        options: the flags.
        enter: told when a stage begins.

    Raises:
        UserError: the mesh cannot be read or has no surface, a cut is wrong, or an option has no
            effect.
    """
    from gscomplete.framing.decide import frame_about
    from gscomplete.util.parse import require_seed
    from splatcomplete_data.cli.common import framing_request
    from splatcomplete_data.cuts.named import ScanCut, apply_cuts, parse_cut, scanner_position
    from splatcomplete_data.framing import moved_center
    from splatcomplete_data.mesh.convert import OUTLINE_PX, ConvertSettings, convert_mesh
    from splatcomplete_data.mesh.files.load import BakedLight, load_mesh
    from splatcomplete_data.mesh.files.up_axis import up_of_mesh_file
    from splatcomplete_data.points import offset_note, without_offset

    _require_heeded(options)
    cuts = [parse_cut(text) for text in options.cut]
    require_seed(options.seed)
    enter("reading", 0.0)
    mesh = load_mesh(
        options.file,
        texture=options.texture,
        gltf_colors=options.gltf_colors,
        allow_outside=options.allow_outside,
    )
    repairs: tuple[StepRecord, ...] = ()
    if options.repair:
        from splatcomplete_data.mesh.repair import repair_mesh

        enter("repairing", 0.1)
        mesh, repairs = repair_mesh(mesh)
    outline_px = options.outline_px
    if outline_px is None:
        outline_px = 0.0 if any(isinstance(cut, ScanCut) for cut in cuts) else OUTLINE_PX
    settings = ConvertSettings(
        options.mode, options.sigma, outline_px=outline_px, seed=options.seed
    )
    count = 100_000 if options.count is None and options.spacing is None else options.count
    request = framing_request(options, up_of_mesh_file(options.file))
    light = BakedLight.from_above(request.up) if options.light else None
    enter("converting", 0.2)
    with naming(options.file):
        made = convert_mesh(mesh, count, spacing=options.spacing, settings=settings, light=light)
    complete = made.splats
    part: Splats | None = None
    steps: tuple[StepRecord, ...] = ()
    scanner = None
    moved = None if mesh.offset is None else without_offset(mesh.offset)
    if cuts:
        enter("cutting", 0.5)
        frame = frame_about(complete, request if moved is None else moved_center(request, moved))
        part, steps = apply_cuts(complete, frame, cuts, (), str(options.file))
        scanner = scanner_position(cuts, frame)
    far = () if mesh.offset is None else (offset_note(mesh.offset),)
    size = f"{len(complete):,} splats, spacing {made.spacing:.4g} file units"
    return ObjectDraft(
        "mesh",
        options.file,
        part,
        complete,
        request.up,
        (*repairs, *made.steps, *steps),
        (*mesh.notes, *far, size),
        file_from_source=moved,
        camera_position_file=scanner,
        is_center_of_source=True,
    )


def _require_heeded(options: MeshOptions) -> None:
    """Refuse options that the file's format or the mode has no use for.

    Raises:
        UserError: there is one.
    """
    from splatcomplete_data.mesh.files.file_checks import GLTF_SUFFIXES

    suffix = options.file.suffix.lower()
    if options.gltf_colors != "linear" and suffix not in GLTF_SUFFIXES:
        raise UserError(
            f"--gltf-colors {options.gltf_colors}: has no effect on {suffix} files; leave it out"
        )
    if options.outline_px is not None and options.mode != "cells":
        raise UserError(
            f"--outline-px {options.outline_px:g}: has no effect with --mode {options.mode}; leave "
            "it out"
        )
