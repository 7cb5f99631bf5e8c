"""Which plane of symmetry is the right one, by a small network over the evidence for each plane.

It was trained on procedural objects whose truth is known (``recipes/train_embedded_prior``). It
prefers planes whose copy of P covers much of what is missing and little that is empty in truth.

Conventions
-----------
* Scores are logits; their softmax over all planes of ``planes.features`` is the belief in each
  plane.
"""

from __future__ import annotations

import functools

from gscomplete.networks.packaged import PACKAGED_WEIGHTS
from gscomplete.networks.perceptron import Perceptron
from gscomplete.shape.planes.features import FEATURES

COARSE_SCORER_FILE = "planes.safetensors"


@functools.cache
def packaged_coarse_scorer() -> Perceptron:
    """Return the network that ships with the package."""
    return Perceptron.load(PACKAGED_WEIGHTS / COARSE_SCORER_FILE, len(FEATURES))
