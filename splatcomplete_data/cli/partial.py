"""``splatcomplete-data partial``: a part cut out of a complete splat object."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from gscomplete.errors import UserError
from splatcomplete_data.cli.common import (
    ObjectDraft,
    ObjectOptions,
    check_out,
    finish_object,
    framing_request,
)

if TYPE_CHECKING:
    from gscomplete.splats import Similarity, Splats
    from splatcomplete_data.objects import ObjectRecord, StepRecord


@dataclass(frozen=True, kw_only=True)
class PartialOptions(ObjectOptions):
    """Cut a part out of a complete object, so that a pair (partial, complete) exists.

    FILE is a splat file, or an object folder with a complete.ply. Unless --up says otherwise, up is
    as the object.json says if FILE is an object folder or a file in one, else -Y.

    Example: splatcomplete-data partial duck --cut scan:30/20 --out duck_scanned
    """

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """Splat file (any format that ``convert`` reads) or object folder."""
    cut: tuple[str, ...] = ()
    """Parts to keep: plane:AZIMUTH[,OFFSET], box:LX,LY,LZ,HX,HY,HZ or scan:AZ/EL[,AZ/EL...] (object
    frame)."""
    box: tuple[str, ...] = ()
    """Boxes in the file frame: [keep:|remove:]CX,CY,CZ,HX,HY,HZ[,QW,QX,QY,QZ], or a file of boxes
    saved by `crop --pick`."""
    seen_from_views: int = 0
    """Keep what is visible from this many views of V (--view, --range); 0 = do not cut by
    visibility."""
    subset: Literal["multiview", "singleview", "lidar", "mesh"] = "multiview"
    """Kind of source to record for a splat file; an object folder keeps its own."""


def run(options: PartialOptions) -> int:
    """Cut the part; return the exit code."""
    check_out(options, options.file)
    return finish_object(*make(options))


def make(options: PartialOptions) -> tuple[PartialOptions, ObjectDraft]:
    """Read the complete object and cut the part.

    Returns:
        The options, with prompt, licence and origin of an object folder filled in where they were
        not given, and what was made.

    Raises:
        UserError: the file cannot be read, no cut is given, or the cuts keep nothing.
    """
    from gscomplete.folders.drawable import drawable_of
    from gscomplete.framing.decide import frame_about
    from gscomplete.util.file_names import RUN_FILE
    from splatcomplete_data.cuts.boxes import read_boxes
    from splatcomplete_data.cuts.named import ScanCut, apply_cuts, parse_cut, scanner_position
    from splatcomplete_data.framing import SPLAT_FILE_UP, UP_ASSUMED

    cuts = [parse_cut(text) for text in options.cut]
    boxes = tuple(box for text in options.box for box in read_boxes(text))
    source = _read_complete(options.file)
    subset = options.subset
    details: dict[str, str] = {}
    notes, record = source.notes, source.record
    if record is not None:
        subset, default_up = record.subset, record.frame.up
        options = dataclasses.replace(
            options,
            prompt=options.prompt or record.prompt,
            licence=options.licence or record.source.licence,
            origin=options.origin or record.source.origin,
        )
        details = {"complete_from": record.id, "source": record.source.file}
    else:
        is_result = (options.file.parent / RUN_FILE).is_file()
        known = drawable_of(options.file).frame if is_result else None
        default_up = SPLAT_FILE_UP if known is None else known.up
        if known is None and options.up == "auto":
            notes = (*notes, UP_ASSUMED)
    complete, dropped = _drawable(source.splats, options.file)
    request = framing_request(options, default_up)
    frame = frame_about(complete, request)
    if options.seen_from_views > 0:
        from gscomplete.views import ViewDistribution

        if request.view_deg is None:
            raise UserError(
                "--seen-from-views: expected --view AZ,EL, the centre of the views, found none"
            )
        views = ViewDistribution(*request.view_deg, azimuth_range_deg=request.azimuth_range_deg)
        angles = zip(*views.low_discrepancy(options.seen_from_views), strict=True)
        cuts.append(ScanCut(tuple((float(a), float(e)) for a, e in angles)))
    if not cuts and not boxes:
        raise UserError("partial: expected --cut, --box or --seen-from-views, found none of them")
    part, steps = apply_cuts(complete, frame, cuts, boxes, str(options.file))
    made = ObjectDraft(
        subset,
        options.file,
        part,
        complete,
        request.up,
        (*dropped, *steps),
        notes,
        boxes=boxes,
        file_from_source=source.file_from_source,
        camera_position_file=scanner_position(cuts, frame),
        details=details,
    )
    return options, made


@dataclass(frozen=True, slots=True, eq=False)
class _CompleteObject:
    """A complete object, as read."""

    splats: Splats
    record: ObjectRecord | None
    """What is known of it; None = a splat file alone."""
    notes: tuple[str, ...] = ()
    file_from_source: Similarity | None = None


def _read_complete(path: Path) -> _CompleteObject:
    """Read a splat file, alone or of an object folder, or an object folder's complete object.

    Raises:
        UserError: it cannot be read, or the folder has no complete object.
    """
    from gscomplete.splats import Similarity
    from gscomplete.splats.formats.any_file import read_any_splats
    from gscomplete.util.digests import sha256_of
    from splatcomplete_data.objects import (
        COMPLETE_FILE,
        RECORD_FILE,
        read_object,
        record_of_file,
    )

    notes: tuple[str, ...] = ()
    if path.is_dir():
        source = read_object(path)
        if source.complete is None:
            raise UserError(f"{path}: expected an object folder with complete.ply, found none")
        splats, record = source.complete, source.record
        if sha256_of(path / COMPLETE_FILE) != record.files[COMPLETE_FILE].sha256:
            notes = (
                f"doubtful: {path / COMPLETE_FILE} is not the file that {RECORD_FILE} records; "
                "what that says may be of another object",
            )
    else:
        found, known = read_any_splats(path), record_of_file(path)
        if known is None:
            return _CompleteObject(found.splats, None, found.notes, found.file_from_source)
        splats, record, notes = found.splats, known, found.notes
    turn = record.file_from_source
    return _CompleteObject(
        splats, record, notes, None if turn is None else Similarity.from_json(turn)
    )


def _drawable(splats: Splats, source: Path) -> tuple[Splats, tuple[StepRecord, ...]]:
    """Leave out splats that cannot be drawn, such as those at a NaN; record it where there are any.

    Raises:
        UserError: there are no others.
    """
    from gscomplete.splats import usable_rows
    from gscomplete.splats.filters import in_words
    from splatcomplete_data.objects import StepRecord

    if not len(splats):
        raise UserError(f"{source}: expected splats, found none")
    usable, reasons = usable_rows(splats)
    if bool(usable.all()):
        return splats, ()
    kept = splats.select(usable)
    if len(kept) == 0:
        raise UserError(f"{source}: expected splats that can be drawn, found {in_words(reasons)}")
    return kept, (StepRecord("drawable", len(splats), len(kept), reasons),)
