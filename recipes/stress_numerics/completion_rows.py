"""Rows about runs: poisoned priors, rates far too large, odd inputs, far-off coordinates."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch

from gscomplete.completion import schedules
from gscomplete.completion.optimise import Optimisation
from gscomplete.completion.pipeline import Request
from gscomplete.completion.presets import DISTILL, RECONSTRUCT
from gscomplete.completion.run_folder import RunRequest, execute, prepare
from gscomplete.completion.settings import CompletionSettings
from gscomplete.completion.start import start_splats
from gscomplete.errors import UserError
from gscomplete.fitting.checkpoint import FILE_NAME, load_checkpoint
from gscomplete.fitting.finite import NonFiniteError
from gscomplete.fitting.settings import LearningRates
from gscomplete.framing.decide import FramingRequest
from gscomplete.render import render
from gscomplete.splats import Splats, concatenate, read_splats, write_splats
from gscomplete.views import ViewDistribution, orbit_cameras
from recipes.known_priors.priors import NoText
from recipes.stress_numerics.poisoned_prior import Poison, PoisonedPrior
from recipes.stress_numerics.rows import Check, Row, nonfinite
from recipes.stress_numerics.scenes import ball, with_fields

STEPS = 40
QUICK: dict[str, Any] = {
    "steps": STEPS,
    "new_splats": 300,
    "warmup_steps": 4,
    "checkpoint_every": 8,
    "rounds": 5,
}


def _settings(base: CompletionSettings) -> CompletionSettings:
    """Return short settings of a kind."""
    return dataclasses.replace(base, **QUICK)


def _half() -> Splats:
    """Return the half of the ball that is turned to azimuth 0."""
    complete = ball()
    return complete.select(complete.means[:, 0] > 0)


def _request(path: Path, out: Path, settings: CompletionSettings) -> RunRequest:
    """Return a request with a frame that needs no guess."""
    framing = FramingRequest("Z", (0.0, 10.0), center_file=(0.0, 0.0, 0.0), size_file=0.85)
    return RunRequest(path, out, Request("a ball", settings, framing))


def _poisoned(base: CompletionSettings, poison: Poison, calls: int, step: int) -> Iterator[Check]:
    """Let the prior fail, check the files that are left, and resume with a healthy prior."""
    settings, truth = _settings(base), ball()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        partial = folder / "half.ply"
        write_splats(partial, _half())
        bad, good = folder / "bad", folder / "good"
        message = ""
        try:
            prior = PoisonedPrior(truth, poison, calls)
            execute(prepare(_request(partial, bad, settings), prior), lambda report: None)
        except NonFiniteError as error:
            message = str(error)
        tensor = {"loss": "the prior's loss", "target": "colour of the prior's targets"}
        told = (f"step {step}:", tensor.get(poison, "gradient of "), FILE_NAME, str(bad))
        yield Check(f"{poison}: not told", sum(part not in message for part in told), 0)
        yield Check(f"{poison}: result written", int((bad / "completed.ply").exists()), 0)
        status = json.loads((bad / "run.json").read_text())["status"]
        yield Check(f"{poison}: not marked as stopped", int(status != "stopped"), 0)
        state = load_checkpoint(bad / "checkpoints") or {"step": torch.tensor(-1)}
        last = (step // settings.checkpoint_every) * settings.checkpoint_every
        yield Check(f"{poison}: steps lost", abs(last - int(state["step"])), 0)
        again = dataclasses.replace(_request(partial, bad, settings), resume=True)
        execute(prepare(again, PoisonedPrior(truth)), lambda report: None)
        execute(
            prepare(_request(partial, good, settings), PoisonedPrior(truth)), lambda report: None
        )
        same = (bad / "completed.ply").read_bytes() == (good / "completed.ply").read_bytes()
        yield Check(f"{poison}: resumed run differs from an unbroken one", int(not same), 0)


def _poisons(quick: bool) -> Iterator[Check]:
    yield from _poisoned(RECONSTRUCT, "target", 3, 24)
    yield from _poisoned(DISTILL, "gradient", 21, 21)
    if not quick:
        yield from _poisoned(DISTILL, "loss", 30, 30)
        yield from _poisoned(DISTILL, "huge gradient", 17, 17)


def _rates(quick: bool) -> Iterator[Check]:
    for label, base in (("distill", DISTILL), ("reconstruct", RECONSTRUCT)):
        raised = {k: 100 * v for k, v in dataclasses.asdict(base.learning_rates).items()}
        settings = dataclasses.replace(_settings(base), learning_rates=LearningRates(**raised))
        views = ViewDistribution(0.0, 10.0)
        part, prior = _half(), PoisonedPrior(ball())
        start = start_splats(part, prior, NoText(), views, settings).splats
        job = Optimisation(part, start, prior, NoText(), views, settings)
        count, silent = len(job.parameters), 0
        try:
            while not job.finished:
                report = job.step()
                edits = schedules.is_densify_step(settings, report.step)
                edits |= schedules.is_prune_step(settings, report.step)
                silent += int(report.new_splats != count and not edits)
                count = report.new_splats
            left = job.new_splats
            yield Check(f"{label}: non-finite", nonfinite(*(v for _, v in left.fields())), 0)
            yield Check(f"{label}: last count is not the result's", abs(count - len(left)), 0)
        except NonFiniteError as error:
            yield Check(f"{label}: stopped without a step", int(error.step != job.step_number), 0)
        yield Check(f"{label}: counts changed between edits", silent, 0)


def _odd_inputs(quick: bool) -> Iterator[Check]:
    half = _half()
    odd = Splats(**{name: value[:60].clone() for name, value in half.fields()})
    odd.scales[:10] = torch.tensor([0.3, 3e-7, 3e-7])
    odd.scales[10:15] = 1e-8
    odd.opacities[15:20], odd.opacities[20:25] = 0.0, 1.0
    odd.means[25:30] = odd.means[25]
    odd.means[30] = torch.tensor([1e17, 0.0, 0.0])
    odd.means[31] = torch.tensor([0.0, -1e6, 0.0])
    odd.scales[32] = 1e3
    odd.opacities[32] = 0.01
    yield from _kept(concatenate([half, odd]), "odd splats")
    yield from _refused(with_fields(half, opacities=0.0), "all transparent")
    yield from _refused(with_fields(half, means=half.means + 100.0), "out of sight")
    if not quick:
        yield from _kept(half.select(torch.tensor([0])), "one splat")
        yield from _kept(with_fields(half, scales=torch.tensor([0.4, 4e-7, 4e-7])), "needles")
        yield from _kept(with_fields(half, scales=1e-8), "invisibly small")


def _refused(partial: Splats, label: str) -> Iterator[Check]:
    """Request an impossible completion, and check that it is refused before it begins."""
    with tempfile.TemporaryDirectory() as name:
        path, out = Path(name) / "odd.ply", Path(name) / "out"
        write_splats(path, partial)
        try:
            prepare(_request(path, out, _settings(RECONSTRUCT)), PoisonedPrior(ball()))
            told = False
        except UserError as error:
            told = str(path) in str(error)
        yield Check(f"{label}: not refused", int(not told), 0)
        yield Check(f"{label}: folder left behind", int(out.exists()), 0)


def _kept(partial: Splats, label: str) -> Iterator[Check]:
    """Complete a partial object and check counts, bytes and numbers."""
    settings = dataclasses.replace(_settings(RECONSTRUCT), steps=10)
    with tempfile.TemporaryDirectory() as name:
        path, out = Path(name) / "odd.ply", Path(name) / "out"
        write_splats(path, partial)
        run = prepare(_request(path, out, settings), PoisonedPrior(ball()))
        content = execute(run, lambda report: None)
        source, completed = read_splats(path), read_splats(out / "completed.ply")
        old = bytes(source.payload.records)
        kept = bytes(completed.payload.records)[: len(old)] == old
        yield Check(f"{label}: records of P changed", int(not kept), 0)
        new = content["result"]["new_splats"]
        rows = completed.n_rows - source.n_rows - new
        yield Check(f"{label}: rows not accounted for", abs(rows), 0)
        told = len(run.prepared.working.splats) + sum(run.prepared.working.unusable.values())
        yield Check(f"{label}: splats of P neither drawn nor named", abs(told - len(partial)), 0)
        added = completed.splats.select(torch.arange(len(partial), completed.n_rows))
        yield Check(f"{label}: non-finite", nonfinite(*(v for _, v in added.fields())), 0)
        numbers = json.dumps(content["result"])
        bad = sum(word in numbers for word in ("NaN", "Infinity"))
        yield Check(f"{label}: metrics that are not finite", bad, 0)


def _far_away(quick: bool) -> Iterator[Check]:
    from gscomplete.cli import main

    half = _half()
    # Multiples of 1/16 below 2^19: float32 holds them exactly at the origin and 1e6 away from it.
    means = (half.means * 5000.0 * 16).round() / 16
    here = dataclasses.replace(half, means=means, scales=half.scales * 5000.0)
    pictures, counts = [], []
    with tempfile.TemporaryDirectory() as name:
        for label, offset in (("here", 0.0), ("far", 1e6)):
            path, out = Path(name) / f"{label}.ply", Path(name) / label
            write_splats(path, dataclasses.replace(here, means=here.means + offset))
            with (
                contextlib.redirect_stdout(io.StringIO()),
                contextlib.redirect_stderr(io.StringIO()),
            ):
                options = ["complete", str(path), "--prompt", "a ball", "--out", str(out)]
                code = main([*options, *(() if quick else ("--preset", "reconstruct"))])
            yield Check(f"{label}: exit code", code, 0)
            source, completed = read_splats(path), read_splats(out / "completed.ply")
            old = bytes(source.payload.records)
            kept = bytes(completed.payload.records)[: len(old)] == old
            yield Check(f"{label}: records of P changed", int(not kept), 0)
            counts.append(completed.n_rows)
            moved = completed.splats.means.double() - offset
            pictures.append(_picture(dataclasses.replace(completed.splats, means=moved.float())))
    yield Check("rows, share of difference", abs(counts[1] / counts[0] - 1), 0)
    error = (pictures[0] - pictures[1]).abs()
    yield Check("picture, mean difference", float(error.mean()), 1e-4)
    yield Check("picture, largest difference", float(error.max()), 0.03)


def _picture(splats: Splats) -> torch.Tensor:  # [2, 96, 96, 3]
    """Draw a ball of size 4000 from two sides."""
    cameras = orbit_cameras(
        torch.tensor([20.0, 200.0]),
        torch.tensor([15.0, 15.0]),
        radius=10_000.0,
        fov_deg=40.0,
        size_px=96,
    )
    with torch.no_grad():
        return render(splats, cameras).color


COMPLETION_ROWS = (
    Row("poisoned prior", "NaN loss, gradient, target; gradient of 1e25", _poisons),
    Row("rates x 100", "all learning rates 100 times too large", _rates),
    Row("odd inputs", "P with needles, dust, 1e17 away, opacity 0 and 1; transparent", _odd_inputs),
    Row("far-off P", "the command line on P of size 4000, and 1e6 away", _far_away),
)
"""Rows about runs."""
