"""``gscomplete complete``: complete a partial splat object."""

from __future__ import annotations

import contextlib
import gc
import json
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from gscomplete.cli.complete_options import CompleteOptions, require_plain_fill
from gscomplete.cli.guard import how_to_go_on
from gscomplete.errors import UserError
from gscomplete.priors.latent.settings import LatentPriorSettings

if TYPE_CHECKING:
    from gscomplete.completion.optimise import StepReport
    from gscomplete.completion.run_folder import Run


_RESUMES = "--resume continues from the last checkpoint"


class GpuMemoryError(UserError):
    """The GPU's memory is not enough for a run."""

    exit_code = 4


def run(options: CompleteOptions) -> int:
    """Complete the object; return the exit code.

    Raises:
        GpuMemoryError: the GPU's memory is not enough.
    """
    import torch

    from gscomplete.completion.kernel_types import COMPILED_BESIDE
    from gscomplete.util.kernels import compilations_told, compile_beside
    from gscomplete.util.stages import profiled

    def tell() -> None:
        print("compiling kernels (only on the first run)", file=sys.stderr)

    compile_beside(COMPILED_BESIDE)
    try:
        with compilations_told(tell):
            if not options.profile:
                return _complete(options)
            with profiled() as profile:
                code = _complete(options)
        _say(options, *profile.lines())
        return code
    except torch.OutOfMemoryError as error:
        raise GpuMemoryError(
            "the GPU ran out of memory; a smaller --diffusion.memory (8gb) or --device cpu needs "
            f"less; {how_to_go_on.get()}"
        ) from error


def _complete(options: CompleteOptions) -> int:
    """Load the prior, run, and report the result."""
    from gscomplete.util.stages import stage

    with _without_collections(), stage("load"):
        from gscomplete.cli.request import request_of
        from gscomplete.completion.run_folder import prepare
        from gscomplete.priors import load_prior
        from gscomplete.render.dispatch import choose_render_device
        from gscomplete.util.device import choose_device

        if options.fill:
            require_plain_fill(options)
        device = choose_device(options.device)
        render_device, fallback = choose_render_device(options.device, device)
        knobs = None if options.diffusion == LatentPriorSettings() else options.diffusion
        prior = load_prior(options.prior, device, knobs)
    with _without_collections():  # a dozen libraries are loaded where they are first needed
        job = prepare(request_of(options, prior), prior, render_device)
    how_to_go_on.set(_RESUMES)
    _say(options, *job.notes, *([fallback] if fallback else []))
    if job.steps.step_number:
        _say(options, f"resuming at step {job.steps.step_number}")
    said = len(job.notes)
    content = _with_progress(job)
    if options.json:
        print(json.dumps(content))
        return 0
    result = content["result"]
    c, views = result["metrics"]["input_view"], result["metrics"]["all_views"]
    peak = result["peak_gpu_bytes"]
    memory = "" if peak is None else f", at most {peak / 2**30:.2f} GiB of GPU memory"
    _say(
        options,
        *job.notes[said:],
        f"{result['new_splats']:,} new splats in {result['seconds']:.1f} s" + memory,
        f"E_color {c['color']:.6f} from c, {views['color']:.6f} over V; "
        f"E_depth {c['depth']:.6f} from c, {views['depth']:.6f} over V"
        + ("" if result["measured_with"] == "P" else f" (of {result['measured_with']})"),
        f"written: {job.request.out}/completed.ply, preview.png, turntable.webp, run.json"
        + (", alternatives.png" if options.alternatives else "")
        + (f"; the new splats alone: {options.new_only}" if options.new_only else ""),
    )
    return 0


@contextlib.contextmanager
def _without_collections() -> Iterator[None]:
    """Suspend garbage collection while modules load and little else is done."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _with_progress(job: Run) -> dict[str, Any]:
    """Run with a progress bar on standard error."""
    from gscomplete.cli.bars import progress_bar
    from gscomplete.completion.run_folder import execute

    if job.steps.finished:
        return execute(job, lambda report: None)
    with progress_bar("completing", "{task.fields[losses]}") as progress:
        task = progress.add_task(
            "complete",
            total=job.steps.settings.steps,
            completed=job.steps.step_number,
            losses="",
        )

        def show(report: StepReport) -> None:
            losses = f"prior {report.guidance_loss:.2f}"
            if report.preservation_loss is not None:
                losses += f"  L_p {report.preservation_loss:.4f}"
            losses += f"  splats {report.new_splats:,}"
            progress.update(task, advance=1, losses=losses)

        return execute(job, show)


def _say(options: CompleteOptions, *lines: str) -> None:
    """Print lines for a person: standard output, or standard error when that is for a machine."""
    for line in lines:
        print(line, file=sys.stderr if options.json else sys.stdout)
