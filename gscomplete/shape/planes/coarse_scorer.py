"""Which plane of symmetry is the right one: a small network over the evidence for each.

It was trained on procedural objects whose truth is known (``recipes/train_embedded_prior``) to
prefer planes whose copy of P covers much of what is missing and little that is not there.

Conventions
-----------
* Scores are logits over all planes of ``planes.features``: their softmax is the belief in each.
* The file holds float32 tensors: two of scaling, then weight and bias of each layer.
"""

from __future__ import annotations

import functools
import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from gscomplete.errors import UserError
from gscomplete.shape.network import PACKAGED_WEIGHTS
from gscomplete.shape.planes.features import FEATURES
from gscomplete.shape.voxels import FloatArray
from gscomplete.util.atomic import atomic_path

COARSE_SCORER_FILE = "planes.safetensors"
LAYERS = 3


@dataclass(frozen=True, slots=True)
class CoarseSymmetryScorer:
    """A perceptron: features in, logit out."""

    tensors: dict[str, FloatArray]
    """``center`` and ``spread`` [F]; ``weight0`` [H, F], ``bias0`` [H], and so on."""

    def __call__(self, features: FloatArray) -> FloatArray:  # [..., F] -> [...]
        """Return the logits of planes."""
        t = self.tensors
        x = (features - t["center"]) / t["spread"]
        for layer in range(LAYERS):
            x = x @ t[f"weight{layer}"].T + t[f"bias{layer}"]
            if layer < LAYERS - 1:
                x = x / (1 + np.exp(-x.clip(-60, 60)))
        return np.ascontiguousarray(x[..., 0], dtype=np.float32)

    def digest(self) -> str:
        """Name the weights: data made with other ones is other data."""
        return hashlib.sha256(save(self.tensors)).hexdigest()[:12]

    def save(self, path: Path) -> None:
        """Write the network to a file."""
        with atomic_path(path) as temporary:
            temporary.write_bytes(save(self.tensors))

    @classmethod
    def load(cls, path: Path) -> CoarseSymmetryScorer:
        """Read a network.

        Raises:
            UserError: the file is missing, damaged, or does not fit the features.
        """
        try:
            tensors = load_file(path)
        except (SafetensorError, OSError) as error:
            raise UserError(f"{path}: expected a safetensors file ({error})") from error
        wide = tensors["weight0"].shape[1] if "weight0" in tensors else 0
        if wide != len(FEATURES):
            raise UserError(f"{path}: weight0: expected {len(FEATURES)} columns, found {wide}")
        return cls(tensors)


@functools.cache
def packaged_coarse_scorer() -> CoarseSymmetryScorer:
    """Return the network that ships with the package."""
    return CoarseSymmetryScorer.load(PACKAGED_WEIGHTS / COARSE_SCORER_FILE)
