"""Where the weights of the shape networks lie: beside those of the embedded prior."""

from __future__ import annotations

from pathlib import Path

PACKAGED_WEIGHTS = Path(__file__).resolve().parents[1] / "priors/embedded/weights"
