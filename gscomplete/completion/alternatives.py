"""Other complete objects that the same part may be of, for users to choose from.

A completion that starts from a guess depends mostly on the plane that P is mirrored through, and
people see at a glance which guess is right, while no measure here does. So the guess by every
likely plane is drawn, with the option that makes a run take it.

Conventions
-----------
* Object frame. Guesses are those of step 0: nothing is optimised or held to bounds.
* A function of (P, V, prompt, settings): the guess by a plane is what a run with it starts from. A
  run by the plane that P ends at has the frame of P and its image, so it differs a little.
"""

from __future__ import annotations

from dataclasses import dataclass

from PIL import Image

from gscomplete.completion.settings import CompletionSettings
from gscomplete.completion.start import colored_for_guess, guess_by, scale_bounds
from gscomplete.evaluate.pictures import contact_sheet, render_images
from gscomplete.priors.base import Conditioning, Prior, ShapePrior
from gscomplete.shape.mirror_plane import ChosenMirror, MirrorPlane
from gscomplete.splats import Splats, concatenate
from gscomplete.views import ViewDistribution

_SIZE_PX = 192


@dataclass(frozen=True, slots=True)
class Alternative:
    """One guess of the complete object."""

    mirror: ChosenMirror
    splats: Splats
    """New splats."""

    @property
    def option(self) -> str:
        """The command-line option that makes a run start from this guess."""
        return f"--mirror={self.mirror}"


def guess_alternatives(
    prior: Prior,
    partial: Splats,
    distribution: ViewDistribution,
    conditioning: Conditioning,
    settings: CompletionSettings,
    count: int,
) -> list[Alternative]:
    """Guess the complete object through the likeliest planes of symmetry, P's end, and none.

    Args:
        prior: of the run.
        partial: P in the object frame.
        distribution: V.
        conditioning: of the prompt.
        settings: of the run.
        count: most planes.

    Returns:
        The guesses by the likeliest planes, the likeliest first; then that by the plane that P ends
        at; last that without mirroring. Nothing if the prior does not guess complete objects.
    """
    if settings.start != "guess" or not isinstance(prior, ShapePrior):
        return []
    seen, _ = colored_for_guess(partial, settings)
    mirrors = prior.likely_mirrors(seen, distribution, conditioning)
    found, bounds = [], scale_bounds(prior.views, settings)
    planes = [mirror for mirror in mirrors if isinstance(mirror, MirrorPlane)]
    others = [mirror for mirror in mirrors if not isinstance(mirror, MirrorPlane)]
    for mirror in (*planes[:count], *others):
        guess = guess_by(seen, prior, conditioning, distribution, settings, mirror)
        if guess is not None:
            found.append(Alternative(mirror, bounds.clamped(guess.splats)))
    return found


def alternatives_sheet(
    alternatives: list[Alternative],
    partial: Splats,
    completed: Splats,
    views: ViewDistribution,
    title: str,
) -> Image.Image:
    """Draw P, the run's result and the guesses from the preview's six views, a row each."""
    cameras = views.preview_cameras(_SIZE_PX)
    completions = [concatenate([partial, alternative.splats]) for alternative in alternatives]
    rows = [render_images(splats, cameras) for splats in (partial, completed, *completions)]
    labels = ["input", "this run", *(alternative.option for alternative in alternatives)]
    title = f"{title}: guesses as they are, before a run keeps P's appearance"
    return contact_sheet(rows, row_labels=labels, title=title)
