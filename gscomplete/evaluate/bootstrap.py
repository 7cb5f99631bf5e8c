"""Confidence interval of a mean over objects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def bootstrap_interval(values: Sequence[float], draws: int = 2000) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of a mean; the same for the same values.

    Args:
        values: one per object, at least one, in any order.
        draws: resampled means.
    """
    ordered = np.sort(np.asarray(values, dtype=np.float64))  # so that their order does not matter
    rng = np.random.default_rng(0)
    means = ordered[rng.integers(len(ordered), size=(draws, len(ordered)))].mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)
