"""The model card of exported weights: how they were trained, on which data, and their limits.

Conventions
-----------
* Markdown, written as ``CARD.md`` beside the weights by ``export``.
"""

from __future__ import annotations

import collections
from collections.abc import Mapping, Sequence

from gscomplete.priors.embedded.model import FourViewDenoiser, count_parameters
from gscomplete.priors.embedded.weights import PriorConfig
from gscomplete.shape.bank.store import BANK_CELLS, BANK_FILE, ShapeBank
from gscomplete.shape.benefit import BENEFIT_SCORER_FILE
from gscomplete.shape.network import ShapeCompleter
from gscomplete.shape.outline.scorer import CAPTURE_OUTLINE_SCORER_FILE, OUTLINE_SCORER_FILE
from gscomplete.shape.planes.answer_scorer import ANSWER_SCORER_FILE
from gscomplete.shape.planes.coarse_scorer import COARSE_SCORER_FILE
from gscomplete.shape.planes.fine_scorer import FINE_SCORER_FILE
from gscomplete.shape.surface.depth import SURFACE_DEPTH_FILE
from gscomplete.shape.voxels import CELL_SIDE, CELLS
from gscomplete.splats.strays import STRAY_SCORER_FILE
from recipes.train_embedded_prior.data.mesh_pack import PackEntry


def card(
    config: PriorConfig,
    model: FourViewDenoiser,
    shape: ShapeCompleter | None,
    losses: dict[str, dict[str, float]],
    shape_losses: dict[str, float],
    history: str = "",
    bank: ShapeBank | None = None,
    meshes: Mapping[str, Sequence[PackEntry]] | None = None,
) -> str:
    """Describe the weights in Markdown; ``meshes`` are those that each network was trained on."""
    views, training = config.views, config.training
    trained_on = meshes or {}
    lines = [
        "# Embedded prior",
        "",
        "A four-view, camera-, text- and input-conditioned denoiser of premultiplied RGBA images,",
        "and a three-dimensional network that guesses the complete object from a part. Both are",
        "trained by `recipes/train_embedded_prior` on procedural objects"
        + "".join(f", the {network} also on free meshes" for network in trained_on)
        + ".",
        "No third-party models, no downloads. Licence: Apache-2.0, as the rest of the repository.",
        "",
        f"* Parameters: {count_parameters(model) / 1e6:.1f} million, stored as {config.storage}.",
        f"* Images: {views.resolution_px} x {views.resolution_px}, field of view "
        f"{views.fov_deg:g} degrees, visible extent {views.extent_range[0]:g} to "
        f"{views.extent_range[1]:g} object sizes, elevation {views.elevation_range_deg[0]:g} to "
        f"{views.elevation_range_deg[1]:g} degrees.",
        f"* Words: {len(config.words)}.",
        f"* Training: {training.steps} steps, {training.sets} four-view sets, each seen once, "
        f"{training.hours:.2f} hours on {training.machine}, seed {training.seed}.",
        "",
    ]
    if losses:
        lines += [
            "Mean squared error of v on held-out objects (all timesteps; see `evaluate.py`):",
            "",
            "| weights | given P | given a known shape | given text alone |",
            "| --- | --- | --- | --- |",
            *(
                f"| {name} | {values['input_mean']:.4f} | {values['shape_mean']:.4f} "
                f"| {values['text_mean']:.4f} |"
                for name, values in losses.items()
            ),
            "",
        ]
    if shape is not None and config.shape is not None:
        made = config.shape.training
        lines += [
            "## Shape network",
            "",
            f"* Parameters: {count_parameters(shape) / 1e6:.1f} million, stored as "
            f"{config.storage}; {CELLS}^3 cells of {CELL_SIDE:g} object sizes.",
            f"* Words: {len(config.shape.words)}.",
            f"* Training: {made.steps} steps, {made.sets} objects with their parts, each seen "
            f"about twice in different orientations, {made.hours:.2f} hours on {made.machine}, "
            f"seed {made.seed}.",
            f"* Planes that P is mirrored through are scored by `{COARSE_SCORER_FILE}` and then "
            f"by `{FINE_SCORER_FILE}`, trained before it by `train_coarse_scorer.py` and "
            f"`train_fine_scorer.py` of `recipes/train_embedded_prior/small_networks`; its answers "
            f"with them by `{ANSWER_SCORER_FILE}`, trained after it by `train_answer_scorer.py`. "
            f"`{BENEFIT_SCORER_FILE}` predicts whether P is better left as it is "
            f"(`train_benefit_scorer.py`), `{OUTLINE_SCORER_FILE}` which views have the object's "
            f"whole outline (`train_outline_scorer.py`), `{CAPTURE_OUTLINE_SCORER_FILE}` the same "
            f"of captures that are not cut (with `--captures 96`), `{SURFACE_DEPTH_FILE}` how deep "
            f"inside the predicted surface the true one lies (`train_surface_depth.py`), and "
            f"`{STRAY_SCORER_FILE}` which of P's splats float beside its surface "
            f"(`train_stray_scorer.py`).",
            *([f"* History: {history}"] if history else []),
            *(f"* Held-out {name}: {value:.4f}" for name, value in shape_losses.items()),
            "",
        ]
    lines += [
        *(line for network, used in trained_on.items() for line in _mesh_lines(network, used)),
        *_bank_lines(bank),
        "Known limits: one object at a time, of the kinds named by its words and of simple shape.",
        "The shape network continues coarse shape; colours and patterns are those of P and its",
        "mirror images, so regions that P lacks are guessed by symmetry. Thin parts are often",
        "missed if no mirror image is certain enough to be added as P's own splats. The denoiser",
        "follows the colours of prompts but hardly their shapes: from words alone it makes blobs;",
        "given a known shape of the noun, it paints that shape.",
        "",
    ]
    return "\n".join(lines)


def _mesh_lines(network: str, meshes: Sequence[PackEntry]) -> list[str]:
    """Name the sources of the meshes trained on, and authors whose licence asks for it."""
    counts = collections.Counter((entry.source, entry.licence) for entry in meshes)
    lines = [
        f"## Meshes that the {network} was trained on",
        "",
        "In addition to procedural objects; none are of the pack's validation split.",
        "",
        "| source | objects | licence |",
        "| --- | --- | --- |",
        *(f"| {name} | {count} | {terms} |" for (name, terms), count in counts.most_common()),
        "",
    ]
    named = {_plain_author(entry.author) for entry in meshes if entry.licence.startswith("CC-BY")}
    if named:
        lines += [f"Authors of those under CC-BY: {', '.join(sorted(named, key=str.lower))}.", ""]
    return lines


def _plain_author(text: str) -> str:
    """Return an author's name without what stands around it."""
    return text.rsplit(">", 1)[-1].strip().strip('"')


def _bank_lines(bank: ShapeBank | None) -> list[str]:
    """Say where the known shapes are from; none = none goes with the weights."""
    if bank is None:
        return []
    packs = collections.Counter(name.pack for name in bank.names)
    listed = ", ".join(f"{pack} {count}" for pack, count in packs.most_common())
    return [
        "## Known shapes",
        "",
        f"`{BANK_FILE}`: surfaces of {len(bank.names)} free meshes (CC0; no colours), "
        f"{BANK_CELLS}^3 cells each, with their nouns, packed by `shape_bank.py`. "
        f"By first part of their ids: {listed}.",
        "",
    ]
