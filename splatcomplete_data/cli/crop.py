"""``splatcomplete-data crop``: cut the object out of a scene."""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from gscomplete.errors import UserError, naming
from splatcomplete_data.cli.common import (
    ObjectDraft,
    ObjectOptions,
    check_out,
    finish_object,
    say,
)

if TYPE_CHECKING:
    from gscomplete.util.arrays import BoolArray
    from splatcomplete_data.multiview.scene import Scene


@dataclass(frozen=True, kw_only=True)
class CropOptions(ObjectOptions):
    """Cut an object out of a trained scene with boxes; records are copied byte for byte.

    FILE is a splat PLY, or the capture folder of `images`, whose cameras improve `--box auto` and
    give the up axis and the input view. For a splat file up is -Y. --up overrides either. Frame and
    harmonics are not changed; the boxes are recorded, and boxes.png draws them over the scene and
    what they keep.

    Example: splatcomplete-data crop capture --box auto --propose

    Then, with the printed numbers, corrected by hand: splatcomplete-data crop capture
    --box 0.1,0,0.2,0.3,0.3,0.4 --box remove:0,0,-0.3,1,1,0.05 --prompt "a plush doll" --out doll
    """

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """Splat PLY or capture folder."""
    box: tuple[str, ...] = ()
    """Boxes in the file's frame, in order: auto, or [keep:|remove:]CX,CY,CZ,HX,HY,HZ (centre and
    half extents), followed by ,QW,QX,QY,QZ for an oriented box; or a file of boxes saved by --pick.
    Without boxes, everything is kept."""
    pick: Path | None = None
    """Only open a page in which to move, turn and size boxes over the scene, starting with those of
    --box, and save them to this file (.txt), which --box reads."""
    clean: float | None = None
    """Strength, 0 to 1, at which the rules of `clean` are applied to the splats in the boxes, and
    to the scene in which `--box auto` finds the object; None = 0.5 with --box auto, else 0."""
    propose: bool = False
    """Only draw the boxes into boxes.png in the current folder (or --out) and print them."""


def run(options: CropOptions) -> int:
    """Crop; return the exit code."""
    from gscomplete.views import parse_up
    from splatcomplete_data.cli.pick import check_options
    from splatcomplete_data.multiview.scene import read_scene

    if options.pick is not None:
        check_options(options.pick, propose=options.propose)
    scene = read_scene(options.file, None if options.up == "auto" else parse_up(options.up))
    if not options.propose and options.pick is None:
        check_out(options, scene.name)
    boxes, notes = _boxes(options, scene)
    if options.pick is not None:
        return _pick(options, scene, boxes, options.pick)
    if options.propose:
        return _propose(options, scene, boxes, notes)
    with tempfile.TemporaryDirectory(prefix="splatcomplete_crop.") as folder:
        return finish_object(options, make(options, scene, boxes, notes, Path(folder)))


def make(
    options: CropOptions,
    scene: Scene,
    boxes: list[Any],
    notes: list[str],
    folder: Path,
) -> ObjectDraft:
    """Cut the part; its PLY goes into ``folder``.

    Raises:
        UserError: the boxes keep nothing.
    """
    import torch

    from splatcomplete_data.cuts.open_faces import describe_cuts
    from splatcomplete_data.multiview.box_picture import box_sheet
    from splatcomplete_data.multiview.crop import kept_rows, write_rows
    from splatcomplete_data.objects import BOXES_FILE, StepRecord

    mask, reasons = kept_rows(scene.file, boxes)
    notes = [*notes, *describe_cuts(scene.file.splats, boxes)]
    steps = [StepRecord("crop", scene.file.n_rows, int(mask.sum()), reasons)]
    mask, gone = _cleaned(options, scene, mask)
    part = scene.file.splats.select(torch.from_numpy(mask))
    if gone:
        steps.append(StepRecord("clean", steps[0].after, len(part), gone))
    path = folder / "partial.ply"
    write_rows(path, scene.file, mask)
    sheet = box_sheet(scene.drawable(), part, boxes, scene.picture_cameras(boxes), scene.near)
    return ObjectDraft(
        "multiview",
        scene.name,
        part,
        None,
        scene.up_axis,
        tuple(steps),
        tuple(notes),
        tuple(boxes),
        camera_position_file=scene.front_position(boxes),
        details=scene.details(),
        partial_file=path,
        extra_pictures={BOXES_FILE: sheet},
    )


def _boxes(options: CropOptions, scene: Scene) -> tuple[list[Any], list[str]]:
    """Read the boxes, proposing one where ``auto`` stands."""
    import torch

    from splatcomplete_data.clean.rules import clean_rows
    from splatcomplete_data.cuts.boxes import read_boxes
    from splatcomplete_data.multiview.propose_box import propose_box

    boxes, notes = [], list(scene.notes)
    for text in options.box:
        if text == "auto":
            splats = scene.file.splats
            with naming(scene.name):
                cleaned = clean_rows(splats, _strength(options), option="--clean")
            kept = splats.select(torch.from_numpy(cleaned.keep))
            try:
                proposal = propose_box(kept, scene.focus())
            except UserError as error:
                raise UserError(
                    f"{scene.name}: --box auto: {error}; give the box as numbers"
                ) from error
            notes += [f"--box auto: {note}" for note in proposal.notes]
            boxes.append(proposal.box)
        else:
            boxes += read_boxes(text)
    return boxes, notes


def _strength(options: CropOptions) -> float:
    """Return how strictly to clean."""
    if options.clean is not None:
        return options.clean
    return 0.5 if "auto" in options.box else 0.0


def _cleaned(
    options: CropOptions,
    scene: Scene,
    mask: BoolArray,  # [N]
) -> tuple[BoolArray, dict[str, int]]:
    """Take from what the boxes keep what the rules of ``clean`` mark; return why, too."""
    import torch

    from splatcomplete_data.clean.rules import clean_rows

    rows = torch.from_numpy(mask)
    kept = scene.file.splats.select(rows)
    with naming(scene.name):
        cleaned = clean_rows(kept, _strength(options), option="--clean")
    mask = mask.copy()
    mask[mask] = cleaned.keep
    return mask, cleaned.reasons


def _propose(options: CropOptions, scene: Scene, boxes: list[Any], notes: list[str]) -> int:
    """Draw and print the boxes, and write nothing else."""
    import json

    import torch

    from gscomplete.evaluate.pictures import require_own_picture, save_image
    from gscomplete.util import jsonio
    from splatcomplete_data.cuts.boxes import box_text
    from splatcomplete_data.cuts.open_faces import describe_cuts
    from splatcomplete_data.multiview.box_picture import box_sheet
    from splatcomplete_data.multiview.crop import kept_rows
    from splatcomplete_data.objects import BOXES_FILE, RECORD_FILE

    if not boxes:
        raise UserError("--propose: expected --box auto or a box as numbers, found none")
    if options.out is not None and (options.out / RECORD_FILE).exists():
        raise UserError(
            f"{options.out}: --propose: expected a folder without a finished object, whose "
            f"{BOXES_FILE} would be replaced"
        )
    path = (options.out or Path()) / BOXES_FILE
    require_own_picture(path)
    mask, _ = kept_rows(scene.file, boxes)
    mask, gone = _cleaned(options, scene, mask)
    part = scene.file.splats.select(torch.from_numpy(mask))
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
    sheet = box_sheet(scene.drawable(), part, boxes, scene.picture_cameras(boxes), scene.near)
    save_image(sheet, path)
    say(options, *notes, *describe_cuts(scene.file.splats, boxes))
    for box in boxes:
        say(options, f"--box {box_text(box)}")
    for reason, count in gone.items():
        say(options, f"--clean: {count:,} {reason}")
    say(options, f"keeps {int(mask.sum()):,} of {len(mask):,} splats; drawn: {path}")
    if options.json:
        data = {"boxes": jsonio.to_json(boxes), "kept": int(mask.sum()), "splats": len(mask)}
        sys.stdout.write(json.dumps(data) + "\n")
    return 0


def _pick(options: CropOptions, scene: Scene, boxes: list[Any], path: Path) -> int:
    """Let the user choose boxes on a page."""
    from gscomplete.views import axis_direction
    from splatcomplete_data.cli.pick import run_page
    from splatcomplete_data.cuts.box_page import PickedPoints

    shown = scene.drawable()
    colors = shown.base_colors.clamp(0, 1).numpy()
    picked = PickedPoints(shown.means.numpy(), colors, axis_direction(scene.up_axis))
    return run_page(picked, boxes, path, "crop", options.file)
