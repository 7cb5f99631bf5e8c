"""Where the weights are that ship with the package."""

from pathlib import Path

PACKAGED_WEIGHTS = Path(__file__).resolve().parents[1] / "priors/embedded/weights"
"""Folder of the embedded prior and of the small networks about it; its ``CARD.md`` says what is in
it."""
