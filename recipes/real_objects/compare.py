"""Compare ways to complete real objects: ``python -m recipes.real_objects.compare --out DIR``.

Every object is completed (or not) in ten ways and compared with the truth from eight views:

* ``input``: P alone.
* ``likeliest``: P and its mirror image through the plane that is proposed first.
* ``mirror``: P and the best of three mirror images, *chosen with the truth*: through that plane,
  through the next plane that gives a different image, and through both in succession. It is an
  upper bound for a method that has these images but not the truth.
* ``text``: the default preset with P withheld from the prior (no first guess, no renders of P).
* ``reconstruct``: the first guess, then rounds of denoised views that splats are fitted to.
* ``fast``: the fast preset.
* ``default``: the default preset.
* ``distill``: score distillation from the first guess.
* ``alternatives``: the best of up to nine first guesses, through the likely planes of symmetry and
  through none, *chosen with the truth*: an upper bound for a user who chooses among the pictures
  of ``--alternatives``.
* ``true_shape``: the truth's own splats where P lacks them, in the colours of P's nearest ones: the
  result of knowing the shape exactly, but only the colours that P shows.

Silhouettes and hidden colours are measured from the same eight views for all ways. Preservation
errors are measured over the V that a way ends with (``input_view_deg``), since runs may revise it.
Scans have no truth: their pictures are drawn and their preservation errors measured. Results go to
``comparison.json`` and ``comparison.png``; an interrupted comparison goes on where it stopped.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch
from PIL import Image
from rich.console import Console
from rich.progress import track
from scipy.spatial import cKDTree

from gscomplete.completion.alternatives import guess_alternatives
from gscomplete.completion.pipeline import Request, finish, framing_for, prepare
from gscomplete.completion.presets import PresetName, preset
from gscomplete.completion.settings import CompletionSettings
from gscomplete.evaluate.metrics import (
    MID_GREY,
    against_truth,
    preservation,
    truth_errors_of_renders,
)
from gscomplete.evaluate.pictures import contact_sheet, render_images, save_image
from gscomplete.evaluate.report import truth_pictures_of_renders
from gscomplete.framing.decide import FramingRequest
from gscomplete.priors import Prior, load_prior
from gscomplete.priors.base import prior_identity
from gscomplete.render import render
from gscomplete.shape.partial_voxels import voxelize_partial
from gscomplete.shape.planes.proposals import candidate_planes
from gscomplete.shape.symmetry import mirror_image
from gscomplete.shape.symmetry_choice import CANDIDATES
from gscomplete.splats import Splats, colors_to_sh, concatenate, read_splats, write_splats
from gscomplete.splats.transform import transform_splats
from gscomplete.splats.working_set import working_set
from gscomplete.util import jsonio
from gscomplete.views import ViewDistribution
from gscomplete.views.frame import up_rotation
from recipes.entry_point import start
from recipes.real_objects.complete import DATA
from recipes.real_objects.load import RealObject, load_real_object
from recipes.results import Results

Way = Literal[
    "input", "likeliest", "mirror", "text", "reconstruct", "fast", "default", "distill",
    "alternatives", "true_shape",
]  # fmt: skip
WAYS: tuple[Way, ...] = get_args(Way)
OBJECTS = (
    "blue_mug", "bowl", "apple", "stapler", "armchair", "refrigerator", "lantern", "sofa",
    "soccer_ball", "duck", "knight", "chair", "donut", "frying_pan", "statue", "cow", "bottle",
    "speaker", "biker", "armadillo", "tree", "scan_cake_tin", "scan_yellow_bowl", "scan_cereal_box",
)  # fmt: skip
"""Eighteen meshes of as many kinds, three others (a trained splat file, a statue without colours, a
tree of loose parts), and three scans."""
_SAME_PLACE = 1e-6
"""Splats of the truth this near to one of P's are P's own, object sizes."""


@dataclass(frozen=True)
class Options:
    """Compare ways to complete real objects."""

    out: Path
    """Folder for results; completions are kept in it as splat files."""
    names: tuple[str, ...] = OBJECTS
    """Objects by name."""
    ways: tuple[Way, ...] = WAYS
    """Ways to complete them."""
    data: Path = DATA
    """Folder of the real data."""
    seed: int = 0


@dataclass(frozen=True, slots=True)
class FramedObject:
    """A real object in the frame that was guessed from its part."""

    item: RealObject
    partial: Splats
    truth: Splats | None
    views: ViewDistribution
    """V as guessed from the part."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one way to complete adds to a part."""

    splats: Splats
    """New splats, object frame."""
    views: ViewDistribution
    """V: from its views P keeps its appearance."""
    seconds: float


def frame_object(item: RealObject, prior: Prior) -> FramedObject:
    """Guess the frame and the input view from the part, as a run does."""
    heeded = working_set(item.partial, None, item.name, up_rotation(item.up)).heeded
    guess = framing_for(heeded, FramingRequest(item.up), prior)
    to_frame = guess.frame.object_from_file
    truth = item.complete
    return FramedObject(
        item,
        transform_splats(item.partial, to_frame),
        None if truth is None else transform_splats(truth, to_frame),
        guess.views,
    )


def outcome_of(framed: FramedObject, way: Way, prior: Prior, seed: int) -> Outcome:
    """Complete a part in one way."""
    if way in ("fast", "default", "distill", "reconstruct", "text"):
        settings = settings_of(way, prior, seed)
        captured = framed.item.captured
        return completed_as_run(framed, prior, dataclasses.replace(settings, captured=captured))
    started = time.perf_counter()
    found: Splats | None = None
    if way == "likeliest":
        found = mirror_images(framed)[0]
    elif way == "mirror":
        found = best_by_truth(mirror_images(framed), framed)
    elif way == "alternatives":
        found = best_by_truth(alternatives(framed, prior, seed), framed)
    elif way == "true_shape":
        found = true_shape(framed)
    nothing = framed.partial.with_sh_degree(0).select(torch.arange(0))
    return Outcome(found or nothing, framed.views, time.perf_counter() - started)


def completed_as_run(framed: FramedObject, prior: Prior, settings: CompletionSettings) -> Outcome:
    """Complete a part as a run does whose user gives the up axis alone."""
    started = time.perf_counter()
    item = framed.item
    request = Request(item.prompt, settings, FramingRequest(item.up))
    prepared = prepare(item.partial, request, prior)
    while not prepared.steps.finished:
        prepared.steps.step()
    completed = finish(prepared, item.partial)
    return Outcome(completed.new, completed.views, time.perf_counter() - started)


def settings_of(way: Way, prior: Prior, seed: int) -> CompletionSettings:
    """Return the settings of a way to complete."""
    name: PresetName = way if way in ("fast", "distill", "reconstruct") else "default"
    chosen = preset(name, prior, text_only=way == "text")
    return dataclasses.replace(chosen, seed=seed)


def mirror_images(framed: FramedObject) -> list[Splats]:
    """Return P's copies by the likeliest planes, the likeliest first; see ``mirror`` above."""
    voxels = voxelize_partial(framed.partial.with_sh_degree(0), framed.views)
    symmetries = voxels.input_symmetries(candidate_planes(voxels, CANDIDATES), 0)
    return [mirror_image(framed.partial, symmetry) for symmetry in symmetries]


def alternatives(framed: FramedObject, prior: Prior, seed: int) -> list[Splats]:
    """Return the new splats of all that ``--alternatives 8`` draws."""
    conditioning = prior.condition(framed.item.prompt)
    settings = settings_of("fast", prior, seed)
    found = guess_alternatives(
        prior, framed.partial, framed.views, conditioning, settings, CANDIDATES
    )
    return [alternative.splats for alternative in found]


def true_shape(framed: FramedObject) -> Splats | None:
    """Return what P lacks of the truth, in P's nearest colours; None where the truth is unknown."""
    if framed.truth is None:
        return None
    truth = framed.truth.with_sh_degree(0)
    distance, nearest = cKDTree(framed.partial.means.numpy()).query(truth.means.numpy())
    lacking = torch.from_numpy(distance > _SAME_PLACE)
    colors = framed.partial.base_colors[torch.from_numpy(nearest)[lacking]]
    return dataclasses.replace(truth.select(lacking), sh=colors_to_sh(colors))


def best_by_truth(copies: list[Splats], framed: FramedObject) -> Splats | None:
    """Return the copy with the best silhouettes; None where the truth is unknown."""
    if framed.truth is None:
        return None
    partial, truth = framed.partial.with_sh_degree(0), framed.truth
    cameras = framed.views.ring(8, 128)
    found = [against_truth(concatenate([partial, c]), partial, truth, cameras) for c in copies]
    best = max(range(len(copies)), key=lambda k: found[k].silhouette_iou)
    return copies[best]


def measure(framed: FramedObject, outcome: Outcome) -> dict[str, Any]:
    """Return the numbers of one completion; silhouettes are seen from the same views for all."""
    partial = framed.partial.with_sh_degree(0)
    views = outcome.views
    together = concatenate([partial, outcome.splats])
    kept = preservation(together, partial, views.cameras(views.measured(16), 128))
    row: dict[str, Any] = {
        "seconds": outcome.seconds,
        "new_splats": len(outcome.splats),
        "input_view_deg": [views.azimuth_deg, views.elevation_deg],
        "e_color_v": kept.color,
        "e_depth_v": kept.depth,
    }
    if framed.truth is not None:
        truth = framed.truth.with_sh_degree(0)
        cameras, behind = framed.views.ring(8, 256), truth.means.new_tensor(MID_GREY)
        with torch.no_grad():
            renders = [render(splats, cameras, behind) for splats in (together, partial, truth)]
        row |= jsonio.to_json(truth_errors_of_renders(*renders))
        row |= jsonio.to_json(truth_pictures_of_renders(*renders))
    return row


def main(options: Options) -> None:
    """Complete, measure, draw."""
    prior = load_prior("embedded", "cpu")
    made_with = {"seed": options.seed, "prior": prior_identity(prior)}
    results = Results(options.out / "comparison.json", made_with)
    pictures: list[list[Image.Image]] = []
    for name in track(options.names, "objects", console=Console(file=sys.stderr)):
        framed = frame_object(load_real_object(name, options.data), prior)
        rows = results.rows.setdefault(name, {"prompt": framed.item.prompt})
        for way in options.ways:
            kept = options.out / f"{name}.{way}.ply"
            if way not in rows:
                outcome = outcome_of(framed, way, prior, options.seed)
                rows[way] = measure(framed, outcome)
                if len(outcome.splats):
                    write_splats(kept, outcome.splats)
                results.save()
        pictures.append(_picture_row(framed, options.out / f"{name}.default.ply"))
    sheet = contact_sheet(
        pictures, row_labels=list(options.names), title="input | completion | truth"
    )
    save_image(sheet, options.out / "comparison.png")
    sys.stdout.write(table(results.rows, options.ways))


def _picture_row(framed: FramedObject, completed: Path) -> list[Image.Image]:
    """Draw input, completion and truth (or the completion from elsewhere) from four sides."""
    cameras = framed.views.preview_cameras(144)[[0, 1, 3, 5]]
    partial = framed.partial.with_sh_degree(0)
    together = partial
    if completed.exists():
        together = concatenate([partial, read_splats(completed).splats])
    row = [*render_images(partial, cameras), *render_images(together, cameras)]
    return row if framed.truth is None else [*row, *render_images(framed.truth, cameras)]


def table(results: dict[str, dict[str, Any]], ways: tuple[Way, ...]) -> str:
    """Show every object's silhouettes by way, then the means of everything.

    Objects that an earlier run completed in other ways only are left out.
    """
    lines = [f"{'silhouette IoU':18}" + "".join(f"{way:>12}" for way in ways)]
    measured = {name: rows for name, rows in results.items() if set(ways) <= set(rows)}
    known = [name for name, rows in measured.items() if "silhouette_iou" in rows[ways[0]]]
    for name in known:
        values = (results[name][way]["silhouette_iou"] for way in ways)
        lines.append(f"{name:18}" + "".join(f"{value:12.3f}" for value in values))
    for key, label in (
        ("silhouette_iou", "mean silhouette"),
        ("hidden_iou", "mean hidden IoU"),
        ("hidden_color_psnr_db", "hidden PSNR dB"),
        ("color_psnr_db", "PSNR dB"),
        ("e_color_v", "E_color over V"),
        ("e_depth_v", "E_depth over V"),
        ("seconds", "seconds"),
    ):
        form = ".5f" if key.startswith("e_") else ".3f"
        means = [
            mean_of_known([results[name][way].get(key) for name in known or measured], form)
            for way in ways
        ]
        lines.append(f"{label:18}" + "".join(f"{mean:>12}" for mean in means))
    return "\n".join(lines) + "\n"


def mean_of_known(values: Sequence[float | None], form: str) -> str:
    """Write the mean of the values that are known, "unavailable" where none is."""
    known = [value for value in values if value is not None]
    return f"{np.mean(known):{form}}" if known else "unavailable"


if __name__ == "__main__":
    start(main, Options, __doc__)
