"""``splatcomplete-data images``: photos to splats."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from gscomplete.cli.bars import progress_bar
from gscomplete.errors import UserError
from splatcomplete_data.cli.common import say

if TYPE_CHECKING:
    from splatcomplete_data.multiview.reconstruct import Reconstruction
    from splatcomplete_data.multiview.request import Request
    from splatcomplete_data.multiview.training.train import StepReport

_TITLE = "{task.description:>9}"


@dataclass(frozen=True, kw_only=True)
class ImagesOptions:
    """Reconstruct splats from photos of an object or a scene.

    Finds the cameras with COLMAP (or uses yours), trains splats as the original 3DGS does, and
    writes a capture folder: splats.ply, capture.json, preview.png. Then `crop` cuts the object out
    into an object folder. With the defaults it takes about 8 minutes on two cores.

    DIR holds the photos, or a folder `images` with them. Poses that are found there are used:
    transforms.json (nerfstudio, instant-ngp) or sparse/0 (COLMAP). Alpha channels or a folder of
    masks restrict the splats to the object. An EXIF rotation tells which way is up, but pixels are
    used as stored, as in COLMAP.

    Example: splatcomplete-data images photos --out capture
    then: splatcomplete-data crop capture --box auto --prompt "a plush doll" --out doll
    """

    images: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Folder of photos: JPEG, PNG, WebP, TIFF or BMP; others (HEIC, raw files) are skipped, and a
    note gives their number."""
    out: Path | None = None
    """Capture folder to write; None = DIR's name with _capture, in the current folder."""
    poses: str = "auto"
    """auto = those in DIR, else sfm; sfm = structure from motion; or the path of a transforms.json
    or of a COLMAP model."""
    masks: Path | None = None
    """Folder of masks, NAME.png for every photo; None = `masks` in or beside DIR, if there."""
    mask_means: Literal["object", "ignore"] = "object"
    """object: nothing is to be reconstructed outside the mask. ignore: pixels outside do not
    count."""
    allow_outside: Path | None = None
    """Another folder from which photos and masks named by a transforms.json or a COLMAP model may
    be read; None = only DIR."""
    max_side: int = 640
    """Photos are scaled down to this longest side in pixels; time grows with its square."""
    hold_out: int = 0
    """N = hold every Nth photo out of training and measure PSNR on it; 0 = none."""
    start: Literal["auto", "points", "random"] = "auto"
    """Initial splats. points: the sparse cloud (triangulated if need be). random: random points.
    auto = the cloud if there can be one."""
    random_points: int = 30_000
    """Number of random points, if they are used."""
    steps: int = 3500
    """Optimiser steps, one photo each; all schedules stretch with them."""
    max_splats: int = 120_000
    """Largest number of splats."""
    sh_degree: Literal[0, 1, 2, 3] = 3
    """Degree of view-dependent colour."""
    sfm_lens: Literal["SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE"] = "OPENCV"
    """Lens model that structure from motion estimates."""
    sfm_lens_per_photo: bool = False
    """Estimate a lens for every photo, because zoom or camera changed."""
    sfm_matching: Literal["auto", "exhaustive", "sequential"] = "auto"
    """Which pairs of photos are matched; use sequential for frames of a video. auto = nearby photos
    if poses are known, else all pairs for up to 250 photos."""
    sfm_features: int = 4096
    """SIFT features per photo."""
    sfm_size: int = 1200
    """Photos are scaled to this longest side in pixels to find features."""
    seed: int = 0
    """Random seed; the same seed and poses give the same bytes."""
    device: str = "auto"
    """cpu, cuda, cuda:1, or auto = cuda if there is one."""
    checkpoint_every: int = 500
    """Steps between checkpoints."""
    resume: bool = False
    """Continue the run in --out; all other options must be the same."""
    overwrite: bool = False
    """Replace an older capture in --out; it stays until the new run is set up."""
    json: bool = False
    """Print only the content of capture.json on standard output; messages go to standard error."""


def run(options: ImagesOptions) -> int:
    """Reconstruct; return the exit code."""
    from gscomplete.util.device import choose_device
    from splatcomplete_data.multiview.reconstruct import execute, prepare

    request = make_request(options)
    device = choose_device(options.device)
    with _stages() as report:
        job = prepare(request, device, report)
    say(options, *job.notes)
    if job.training.step_number:
        say(options, f"resuming at step {job.training.step_number}")
    with _training_bar(job) as show:
        content = execute(job, show)
    if options.json:
        sys.stdout.write(json.dumps(content) + "\n")
        return 0
    result = content["result"]
    line = f"{result['splats']:,} splats in {content['timings']['train_s']:.0f} s; PSNR "
    line += f"{result['train_psnr_db']:.2f} dB on photos trained on"
    if "held_out_psnr_db" in result:
        line += f", {result['held_out_psnr_db']:.2f} dB on {len(job.held_out)} held out"
    say(options, line, f"written: {request.out} (splats.ply, capture.json, preview.png)")
    return 0


def make_request(options: ImagesOptions) -> Request:
    """Turn command-line options into a request.

    Raises:
        UserError: an option is out of range, or a folder is not there.
    """
    from gscomplete.util.parse import require_seed
    from splatcomplete_data.multiview.request import Request
    from splatcomplete_data.multiview.sfm.structure_from_motion import SfmSettings
    from splatcomplete_data.multiview.training.settings import GrowthSettings, TrainingSettings
    from splatcomplete_data.named_files import require_allowed

    for name, least in (
        ("max_side", 16),
        ("steps", 1),
        ("max_splats", 100),
        ("random_points", 100),
        ("hold_out", 0),
        ("checkpoint_every", 1),
        ("sfm_features", 100),
        ("sfm_size", 100),
    ):
        value = getattr(options, name)
        if value < least:
            flag = name.replace("_", "-")
            raise UserError(f"--{flag}: expected at least {least}, found {value}")
    require_seed(options.seed)
    require_allowed(options.allow_outside)
    training = TrainingSettings(
        steps=options.steps,
        seed=options.seed,
        sh_degree=options.sh_degree,
        growth=dataclasses.replace(GrowthSettings(), max_splats=options.max_splats),
    )
    return Request(
        images=options.images,
        out=options.out or Path(f"{options.images.resolve().name}_capture"),
        poses=options.poses,
        masks=options.masks,
        mask_means=options.mask_means,
        allow_outside=options.allow_outside,
        max_side_px=options.max_side,
        hold_out=options.hold_out,
        start=options.start,
        random_points=options.random_points,
        checkpoint_every=options.checkpoint_every,
        resume=options.resume,
        overwrite=options.overwrite,
        training=training,
        sfm=SfmSettings(
            max_image_px=options.sfm_size,
            max_features=options.sfm_features,
            lens=options.sfm_lens,
            lens_per_photo=options.sfm_lens_per_photo,
            matching=options.sfm_matching,
            seed=options.seed,
        ),
    )


@contextmanager
def _stages() -> Iterator[Any]:
    """Show a bar for every stage of structure from motion; yield what they report to."""
    with progress_bar(_TITLE) as bars:
        tasks: dict[str, Any] = {}

        def report(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                for task in tasks.values():
                    bars.update(task, completed=bars.tasks[task].total)
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield report


@contextmanager
def _training_bar(job: Reconstruction) -> Iterator[Any]:
    """Show a bar for the steps; yield what they report to."""
    with progress_bar(_TITLE, "{task.fields[state]}") as bar:
        task = bar.add_task(
            "training",
            total=job.request.training.steps,
            completed=job.training.step_number,
            state="",
        )

        def show(report: StepReport) -> None:
            state = f"loss {report.loss:.4f}  splats {report.splats:,}"
            bar.update(task, advance=1, state=state)

        yield show
