"""Which plane of symmetry is the right one: a small network over the evidence for each.

It was trained on procedural objects whose truth is known (``recipes/train_embedded_prior``) to
prefer planes whose copy of P covers much of what is missing and little that is not there.

Conventions
-----------
* Scores are logits over all planes of ``planes.features``: their softmax is the belief in each.
"""

from __future__ import annotations

import functools

from gscomplete.networks.perceptron import Perceptron
from gscomplete.shape.network import PACKAGED_WEIGHTS
from gscomplete.shape.planes.features import FEATURES

COARSE_SCORER_FILE = "planes.safetensors"


@functools.cache
def packaged_coarse_scorer() -> Perceptron:
    """Return the network that ships with the package."""
    return Perceptron.load(PACKAGED_WEIGHTS / COARSE_SCORER_FILE, len(FEATURES))
