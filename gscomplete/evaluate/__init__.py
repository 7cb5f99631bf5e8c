"""Numbers and pictures that say how good a completion is."""

from gscomplete.evaluate.metrics import (
    PreservationErrors,
    TruthErrors,
    against_truth,
    preservation,
)

__all__ = ["PreservationErrors", "TruthErrors", "against_truth", "preservation"]
