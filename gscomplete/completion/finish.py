"""After the last step: the new splats' colours at the seam, then bounds on P's looks.

Conventions
-----------
* Object frame. A function of (splats, P, V, settings): a resumed run ends as the first would have.
"""

from __future__ import annotations

from dataclasses import dataclass

from gscomplete.completion.preserve.bounds import HardPreservationReport, preserve_hard
from gscomplete.completion.seam import SeamColorReport, match_seam_colors
from gscomplete.completion.settings import CompletionSettings
from gscomplete.splats import Splats
from gscomplete.views import ViewDistribution


@dataclass(frozen=True, slots=True)
class Finished:
    """The new splats of a result, and what was done to them since the last step."""

    splats: Splats
    seam_colors: SeamColorReport | None
    hard_preservation: HardPreservationReport | None

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done, a line for each."""
        reports = (self.seam_colors, self.hard_preservation)
        return tuple(report.summary() for report in reports if report is not None)


def finish_splats(
    new: Splats, partial: Splats, distribution: ViewDistribution, settings: CompletionSettings
) -> Finished:
    """Do to the new splats what the settings ask for after the last step.

    Args:
        new: splats of the last step.
        partial: P in the object frame.
        distribution: V.
        settings: of the run.
    """
    colors, bounds = None, None
    if settings.seam_colors is not None:
        new, colors = match_seam_colors(new, partial, settings.seam_colors)
    if settings.hard_preservation is not None:
        bounded = preserve_hard(
            new, partial, distribution, settings.hard_preservation, settings.seed
        )
        new, bounds = bounded.splats, bounded.report
    return Finished(new, colors, bounds)
