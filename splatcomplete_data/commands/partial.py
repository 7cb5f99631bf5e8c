"""``splatcomplete-data partial``: a part cut out of a complete splat object."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from gscomplete.errors import UserError
from splatcomplete_data.commands.common import (
    Made,
    ObjectOptions,
    check_out,
    finish_object,
    framing_request,
)

if TYPE_CHECKING:
    from gscomplete.splats import Splats
    from splatcomplete_data.objects import StepRecord


@dataclass(frozen=True, kw_only=True)
class PartialOptions(ObjectOptions):
    """Cut a part out of a complete object, so that a pair (partial, complete) exists.

    FILE is a splat file or an object folder with a complete.ply.

    Example: splatcomplete-data partial duck --cut scan:30/20 --out duck_scanned
    """

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """Splat file (.ply, .compressed.ply, .splat, .spz) or object folder."""
    cut: tuple[str, ...] = ()
    """plane:AZIMUTH[,OFFSET], box:LX,LY,LZ,HX,HY,HZ or scan:AZ/EL[,AZ/EL...] (object frame)."""
    box: tuple[str, ...] = ()
    """Boxes in the file frame: [keep:|remove:]CX,CY,CZ,HX,HY,HZ[,QW,QX,QY,QZ]."""
    seen_from_views: int = 0
    """Keep what this many views of V (--view, --range) can see; 0 = do not cut by visibility."""
    subset: Literal["multiview", "singleview", "lidar", "mesh"] = "multiview"
    """Kind of source recorded for a splat file; an object folder keeps its own."""


def run(options: PartialOptions) -> int:
    """Cut the part; return the exit code."""
    check_out(options, options.file)
    return finish_object(*make(options))


def make(options: PartialOptions) -> tuple[PartialOptions, Made]:
    """Read the whole and cut the part.

    Returns:
        The options, with prompt, licence, origin and up axis of an object folder filled in where
        they were not given, and what was made.

    Raises:
        UserError: the file cannot be read, no cut is given, or the cuts keep nothing.
    """
    from gscomplete.splats import Similarity
    from splatcomplete_data.boxes import parse_box
    from splatcomplete_data.cuts import ScanCut, apply_cuts, parse_cut
    from splatcomplete_data.formats import read_any_splats
    from splatcomplete_data.framing import frame_of_whole
    from splatcomplete_data.objects import read_object

    cuts = [parse_cut(text) for text in options.cut]
    boxes = tuple(parse_box(text) for text in options.box)
    subset = options.subset
    default_up: Literal["X", "Y", "Z", "-X", "-Y", "-Z"] = "-Y"
    details: dict[str, str] = {}
    file_from_source: Similarity | None = None
    notes: tuple[str, ...] = ()
    if options.file.is_dir():
        source = read_object(options.file)
        if source.complete is None:
            raise UserError(f"{options.file}: expected complete.ply in the object folder")
        complete, record = source.complete, source.record
        subset, default_up = record.subset, record.frame.up
        options = dataclasses.replace(
            options,
            prompt=options.prompt or record.prompt,
            licence=options.licence or record.source.licence,
            origin=options.origin or record.source.origin,
        )
        details = {"complete_from": record.id, "source": record.source.file}
        if record.file_from_source is not None:
            file_from_source = Similarity.from_json(record.file_from_source)
    else:
        found = read_any_splats(options.file)
        complete, notes, file_from_source = found.splats, found.notes, found.file_from_source
    complete, dropped = _drawable(complete, options.file)
    request = framing_request(options, default_up)
    frame = frame_of_whole(complete, request.up)
    if options.seen_from_views > 0:
        from gscomplete.views import ViewDistribution

        if request.view_deg is None:
            raise UserError("--seen-from-views: expected --view AZ,EL as the middle of the views")
        views = ViewDistribution(*request.view_deg, azimuth_range_deg=request.azimuth_range_deg)
        angles = zip(*views.low_discrepancy(options.seen_from_views), strict=True)
        cuts.append(ScanCut(tuple((float(a), float(e)) for a, e in angles)))
    if not cuts and not boxes:
        raise UserError("partial: expected --cut, --box or --seen-from-views, found none of them")
    part, steps = apply_cuts(complete, frame, cuts, boxes, str(options.file))
    steps = (*dropped, *steps)
    made = Made(subset, options.file, part, complete, request.up, steps, notes, boxes=boxes)
    return options, dataclasses.replace(made, details=details, file_from_source=file_from_source)


def _drawable(splats: Splats, source: Path) -> tuple[Splats, tuple[StepRecord, ...]]:
    """Leave out splats that cannot be drawn, such as those at a NaN; record it where there are any.

    Raises:
        UserError: there are no others.
    """
    from gscomplete.splats import usable_rows
    from splatcomplete_data.objects import StepRecord

    usable, reasons = usable_rows(splats)
    if bool(usable.all()):
        return splats, ()
    kept = splats.select(usable)
    if len(kept) == 0:
        raise UserError(f"{source}: expected splats that can be drawn, found {dict(reasons)}")
    return kept, (StepRecord("drawable", len(splats), len(kept), reasons),)
