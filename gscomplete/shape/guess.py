"""The guess of the complete object, from P and the prompt to new splats.

1. If P is part of a surface of revolution, it is turned about its axis (``surface.turned``). Of the
   network's answer only what this does not contradict is used, and step 3 is left out. So it is if
   P has an n-fold symmetry, whose copies count as P's own (``n_fold_copies``).
2. The network is asked (``predict``).
3. If P's own splats are not to be mirrored, known shapes of the prompt's noun are fitted to P
   (``bank.fit``) and the network is asked again with them (``bank.shown``), in the object frame or
   in a wider one that has room for them (``bank.wider``).
4. The answer becomes splats (``assemble``).

If the user lets the prompt decide, the known shape that suits P best takes the place of the answer
(``bank.as_answer``), in the colour that the prompt names (``colors.prompt``).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from gscomplete.shape.assemble import (
    AssembleSettings,
    assemble_splats,
    hides_nothing,
    is_mirrored,
    is_mirrored_by_splats,
    mirror_plane_of,
)
from gscomplete.shape.bank.as_answer import LIKE_PARTIAL, occupancy_of
from gscomplete.shape.bank.fit import FittedShape
from gscomplete.shape.bank.known import MOST_SHOWN, KnownShapes
from gscomplete.shape.bank.shown import LEAST_SHOWN, occupancy_by_shapes
from gscomplete.shape.bank.wider import shape_in, wider_from_object
from gscomplete.shape.benefit import is_better_left
from gscomplete.shape.colors.prompt import with_prompt_color
from gscomplete.shape.evidence import gather_evidence
from gscomplete.shape.mirror_plane import Mirror, MirrorPlane
from gscomplete.shape.n_fold_copies import n_fold_copies
from gscomplete.shape.network import ShapeCompleter
from gscomplete.shape.placements import plane_in, symmetry_in, views_in
from gscomplete.shape.predict import Prediction, predict
from gscomplete.shape.surface.turned import turned_surface
from gscomplete.shape.symmetry import plane_of
from gscomplete.splats import Splats, concatenate
from gscomplete.splats.geometry.n_fold import find_n_fold
from gscomplete.splats.geometry.neighbourhood import flat_axes
from gscomplete.splats.geometry.revolution import Revolution, find_revolution
from gscomplete.splats.transform import Similarity, transform_splats
from gscomplete.util.arrays import Float32Array
from gscomplete.util.stages import stage
from gscomplete.views import ViewDistribution

_NEXT_TO_NOTHING = 0.02
"""If the prompt changes a smaller share of the filled cells, users are told that it has no visible
effect."""
_BESIDE_AXIS = 0.02
"""The splats of a part of a surface of revolution are not mirrored through planes that pass its
axis at a larger distance."""
_TURNED_NOTE = (
    "P is part of a surface of revolution: it is turned about its axis (--mirror none completes it "
    "by the network alone)"
)
_FOLD_NOTE = (
    "P is symmetric by turns of 1/{folds} about an upright axis: its splats are turned about it "
    "(--mirror none completes it by the network alone)"
)
_LEFT_NOTE = (
    "P seems to lack little or nothing, by its surface and by what the network would add: nothing "
    "is added (--mirror none completes it all the same, --mirror cut if it is one half)"
)


@dataclass(frozen=True, slots=True)
class Guess:
    """What completes P."""

    splats: Splats
    """New splats in the object frame."""
    known: tuple[FittedShape, ...]
    """Known shapes that the guess is made with."""
    notes: tuple[str, ...]
    """What the guess was decided by, for the user."""
    heeds_cut: bool = True
    """Whether the plane that P seems cut along counts; it does not if P's axis lies beside it."""


@dataclass(frozen=True, slots=True)
class NetworkContext:
    """The network, and what is the same in every question to it."""

    model: ShapeCompleter
    """In evaluation mode, on the CPU."""
    tokens: Tensor  # [L] the prompt
    no_tokens: Tensor  # [L] no prompt
    bfloat16: bool
    """Whether the network runs in bfloat16."""
    ends_in_plane: bool
    """Whether P was cut along a plane, as far as found (``framing.cut_plane``)."""
    captured: bool = False
    """Whether P was trained from photos and nothing was cut off it (``shape.outline.scorer``)."""


def guess_complete(
    context: NetworkContext,
    partial: Splats,
    views: ViewDistribution,
    mirror: Mirror,
    known: KnownShapes,
    count: int,
    generator: torch.Generator,
    *,
    mirror_is_cut: bool = False,
    of_ending: Float32Array | None = None,  # [len(benefit.OF_ENDING)]
    plane_back: Callable[[MirrorPlane], MirrorPlane] | None = None,
) -> Guess:
    """Guess the complete object.

    Args:
        context: the network.
        partial: P in the object frame.
        views: V.
        mirror: the plane to mirror P through, or how it is chosen.
        known: access to known shapes.
        count: most new splats, not counting P's own mirrored ones.
        generator: chooses where splats sit.
        mirror_is_cut: whether P seems cut squarely along that plane. It is then mirrored unless it
            is part of a surface of revolution whose axis the plane passes: the cut does not count.
        of_ending: features that tell whether P lacks anything (``benefit.OF_ENDING``); None = P is
            completed in any case.
        plane_back: takes mirror planes to the frame that notes name them in; None = as they are.

    Returns:
        The new splats, object frame, with what decided them; none if P is better left as it is.
    """
    heeds_cut = True
    if (mirror == "guess" or mirror_is_cut) and not known.decide:
        revolution = _revolution(partial, mirror)
        if revolution is not None:
            turned = _turned_guess(context, partial, views, revolution, count, generator)
            if turned is not None:
                return turned
            mirror, mirror_is_cut, heeds_cut = "guess", False, False
        else:
            folded = _folded_guess(context, partial, views, mirror, count, generator)
            if folded is not None:
                return folded
    settings = AssembleSettings(count=count, image_is_all=mirror_is_cut)
    plain = ask_about(context, partial, views, mirror)
    if not known.decide and is_better_left(of_ending, plain.added):
        nothing = partial.with_sh_degree(0).select(torch.arange(0))
        return Guess(nothing, (), (_LEFT_NOTE,))
    notes: tuple[str, ...] = ()
    takes_image = isinstance(mirror, MirrorPlane) or is_mirrored_by_splats(plain)
    if known.decide or not takes_image:  # else little is left to guess from a noun
        found = _by_known_shapes(context, plain, partial, views, mirror, known, settings, generator)
        if found is not None:
            told = known.notes(found.known) + found.notes
            return dataclasses.replace(found, notes=told, heeds_cut=heeds_cut)
        notes = known.notes(())

    def fitted() -> tuple[FittedShape, ...]:
        may = (mirror_is_cut or not isinstance(mirror, MirrorPlane)) and known.may_agree()
        return known.fitted(partial, views) if may else ()

    with stage("surface"):
        assembled = assemble_splats(plain, partial, settings, generator, fitted)
    if assembled.contradicted:
        notes += (known.contradiction(fitted(), assembled.contradicted),)
    told = notes_of(plain, assembled.mirrored, plane_back)
    return Guess(assembled.splats, (), notes + told, heeds_cut)


def _revolution(partial: Splats, mirror: Mirror) -> Revolution | None:
    """Return the surface of revolution that P is part of.

    None = there is none, or the plane that P is to be mirrored through contains its axis.
    """
    with stage("axis"):
        return find_revolution(partial.means.double().numpy(), flat_axes(partial), _cut(mirror))


def _cut(mirror: Mirror) -> tuple[float, float] | None:
    """Return the azimuth in radians and the offset of the plane to mirror through, if it is one."""
    if not isinstance(mirror, MirrorPlane):
        return None
    return math.radians(mirror.azimuth_deg), mirror.offset


def _turned_guess(
    context: NetworkContext,
    partial: Splats,
    views: ViewDistribution,
    revolution: Revolution,
    count: int,
    generator: torch.Generator,
) -> Guess | None:
    """Turn P about its axis, and guess what is not part of the turned surface.

    None = P lacks next to nothing of that surface, or views contradict it.
    """
    with stage("axis"):
        places, axes = partial.means.double().numpy(), flat_axes(partial)
        evidence = gather_evidence(partial, views)
        turned = turned_surface(places, revolution, evidence, generator, axes)
    if turned is None:
        return None
    plain = ask_about(context, partial, views, "guess")
    if revolution.distance_of(*plane_of(plain.inputs.symmetries[0])) > _BESIDE_AXIS:
        plain = plain.without_copies()
    with stage("surface"):
        settings = AssembleSettings(count=count)
        assembled = assemble_splats(plain, partial, settings, generator, turned=turned)
    notes = (_TURNED_NOTE, *_prompt_note(plain.prompt_share))
    return Guess(assembled.splats, (), notes, heeds_cut=False)


def _folded_guess(
    context: NetworkContext,
    partial: Splats,
    views: ViewDistribution,
    mirror: Mirror,
    count: int,
    generator: torch.Generator,
) -> Guess | None:
    """Turn P's own splats by the steps of its n-fold symmetry, and guess what is lacking then.

    None = P is not symmetric so or lacks next to nothing of it, views contradict it, or P is to be
    mirrored through a plane that contains the axis.
    """
    with stage("axis"):
        fold = find_n_fold(partial.means.double().numpy(), flat_axes(partial), _cut(mirror))
        if fold is None:
            return None
        copies = n_fold_copies(partial, fold, gather_evidence(partial, views), generator)
    if copies is None:
        return None
    given = concatenate([partial.with_sh_degree(0), copies])
    plain = ask_about(dataclasses.replace(context, ends_in_plane=False), given, views, "guess")
    plain = plain.without_copies()
    with stage("surface"):
        assembled = assemble_splats(plain, given, AssembleSettings(count=count), generator)
    notes = (_FOLD_NOTE.format(folds=fold.folds), *_prompt_note(plain.prompt_share))
    return Guess(concatenate([copies, assembled.splats]), (), notes, heeds_cut=False)


def _by_known_shapes(
    context: NetworkContext,
    plain: Prediction,
    partial: Splats,
    views: ViewDistribution,
    mirror: Mirror,
    known: KnownShapes,
    settings: AssembleSettings,
    generator: torch.Generator,
) -> Guess | None:
    """Guess with known shapes, in a frame that has room for them; None = they do not count."""
    shapes = known.fitted(partial, views)[: 1 if known.decide else MOST_SHOWN]
    if len(shapes) < (1 if known.decide else LEAST_SHOWN):
        return None
    frame = wider_from_object(partial.means.double().numpy(), shapes)
    there, given = shapes, partial
    if frame is not None:
        given = transform_splats(partial.with_sh_degree(0), frame)
        there = tuple(shape_in(shape, frame) for shape in shapes)
        plain = ask_about(context, given, views_in(views, frame), plane_in(mirror, frame))
    occupancy: Tensor | None
    if known.decide:
        points = given.means.double().numpy()
        occupancy = occupancy_of(there[0], points)
        plain = plain.without_copies()
        settings = dataclasses.replace(settings, near_partial=LIKE_PARTIAL)
    else:
        with stage("known shapes"):
            occupancy = occupancy_by_shapes(
                context.model,
                plain.voxels,
                plain.inputs,
                plain.in_frame,
                there,
                context.tokens,
                bfloat16=context.bfloat16,
            )
    if occupancy is None:
        return None
    heeded = dataclasses.replace(
        plain, output=dataclasses.replace(plain.output, occupancy=occupancy)
    )
    with stage("surface"):
        assembled = assemble_splats(heeded, given, settings, generator)
    splats = assembled.splats
    if known.decide:
        splats = splats.select(hides_nothing(splats, plain.voxels.evidence))
    if frame is not None:
        back = frame.inverse()
        splats, heeded = transform_splats(splats, back), _carried(heeded, back)
    if known.decide:
        splats, notes = with_prompt_color(splats, partial, known.prompt)
        return Guess(splats, shapes, notes)
    return Guess(splats, shapes, notes_of(heeded, assembled.mirrored))


def ask_about(
    context: NetworkContext, partial: Splats, views: ViewDistribution, mirror: Mirror
) -> Prediction:
    """Ask the network about P; arguments are those of :func:`guess_complete`."""
    return predict(
        context.model,
        partial,
        views,
        context.tokens,
        ends_in_plane=context.ends_in_plane,
        no_tokens=context.no_tokens,
        bfloat16=context.bfloat16,
        mirror_plane=mirror,
        captured=context.captured,
    )


def notes_of(
    prediction: Prediction,
    mirrored: int,
    plane_back: Callable[[MirrorPlane], MirrorPlane] | None = None,
) -> tuple[str, ...]:
    """Tell users what decided the guess: their prompt, and the plane that P was mirrored through.

    Args:
        prediction: what the network was given, and its answer.
        mirrored: how many of the new splats are P's own.
        plane_back: takes a plane of the prediction's frame to the user's; None = they are one.
    """
    prompt = _prompt_note(prediction.prompt_share)
    return (*prompt, _mirror_note(prediction, mirrored, plane_back))


def _prompt_note(share: float | None) -> tuple[str, ...]:
    if share is None:
        return ()
    if share < _NEXT_TO_NOTHING:
        decides = "P alone determines it (--prompt-decides lets the prompt do so)"
        return (f"prompt: hardly changes the guessed shape ({share:.1%}): {decides}",)
    return (f"prompt: changes {share:.0%} of the guessed shape",)


def _mirror_note(
    prediction: Prediction,
    mirrored: int,
    plane_back: Callable[[MirrorPlane], MirrorPlane] | None,
) -> str:
    """Name the plane as users would ask for it."""
    if not is_mirrored(prediction):
        return "not mirrored"
    plane = mirror_plane_of(prediction.inputs.symmetries[0])
    if plane_back is not None:
        plane = plane_back(plane)
    how = "P's mirror image is added" if mirrored else "P's mirror image guides the guess"
    return f"{how}: upright plane {plane} (--mirror)"


def _carried(prediction: Prediction, frame: Similarity) -> Prediction:
    """Return a prediction whose mirror planes are expressed in another frame."""
    maps = tuple(symmetry_in(symmetry, frame) for symmetry in prediction.inputs.symmetries)
    inputs = dataclasses.replace(prediction.inputs, symmetries=maps)
    return dataclasses.replace(prediction, inputs=inputs)
