"""Small perceptrons in numpy: a few numbers in, one score out.

Conventions
-----------
* Inputs are centred and scaled first; SiLU follows every layer but the last.
* Rows are multiplied a few at a time: BLAS shares out larger products among its threads, whose
  number would then change the last bits.
* A file holds float32 tensors: ``center`` and ``spread`` [F], then ``weight0`` [H, F], ``bias0``
  [H], and so on.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.numpy import load_file, save
from torch import Tensor, nn

from gscomplete.errors import UserError
from gscomplete.util.arrays import Float32Array
from gscomplete.util.atomic import atomic_path

LAYERS = 3
_ROWS = 16
"""Rows of one product. With a hundred columns and units it has far fewer than the 262,144
multiplications from which on OpenBLAS starts threads."""
_FARTHEST = 60.0
"""Beyond it a logistic function is 0 or 1 in float32."""


@dataclass(frozen=True, slots=True)
class Perceptron:
    """Features in, score out."""

    tensors: dict[str, Float32Array]

    def __call__(
        self,
        features: Float32Array,  # [..., F]
    ) -> Float32Array:  # [...]
        """Return the scores."""
        t = self.tensors
        rows = features.reshape(-1, features.shape[-1])
        padded = np.zeros((-(-len(rows) // _ROWS), _ROWS, rows.shape[1]), np.float32)
        padded.reshape(-1, rows.shape[1])[: len(rows)] = rows
        x = (padded - t["center"]) / t["spread"]
        for layer in range(LAYERS):
            x = x @ t[f"weight{layer}"].T + t[f"bias{layer}"]
            if layer < LAYERS - 1:
                x = x / (1 + np.exp(-x.clip(-_FARTHEST, _FARTHEST)))
        scores = x[..., 0].ravel()[: len(rows)].reshape(features.shape[:-1])
        return np.ascontiguousarray(scores, dtype=np.float32)

    def digest(self) -> str:
        """Return a digest of the weights, which identifies data sets that were made with them."""
        return hashlib.sha256(save(self.tensors)).hexdigest()[:12]

    def save(self, path: Path) -> None:
        """Write the weights to a file."""
        with atomic_path(path) as temporary:
            temporary.write_bytes(save(self.tensors))

    @classmethod
    @torch.no_grad()
    def of(
        cls,
        network: nn.Sequential,
        center: Tensor,  # [F]
        spread: Tensor,  # [F]
    ) -> Perceptron:
        """Return a trained network of ``LAYERS`` linear layers, SiLU between, without dropout."""
        layers = [module for module in network if isinstance(module, nn.Linear)]
        assert len(layers) == LAYERS
        tensors = {"center": center, "spread": spread}
        for n, layer in enumerate(layers):
            tensors |= {f"weight{n}": layer.weight, f"bias{n}": layer.bias}
        return cls({name: value.float().numpy().copy() for name, value in tensors.items()})

    @classmethod
    def load(cls, path: Path, features: int) -> Perceptron:
        """Read the weights of a perceptron of so many features.

        Raises:
            UserError: the file is missing, damaged, or does not fit the features.
        """
        try:
            tensors = load_file(path)
        except (SafetensorError, OSError) as error:
            raise UserError(f"{path}: expected a safetensors file ({error})") from error
        wide = tensors["weight0"].shape[1] if "weight0" in tensors else 0
        if wide != features:
            raise UserError(f"{path}: weight0: expected {features} columns, found {wide}")
        return cls(tensors)
