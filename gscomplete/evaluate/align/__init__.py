"""Bring another system's result to P by a similarity; the paper's authors did it by hand."""

from gscomplete.evaluate.align.align import (
    Alignment,
    AlignmentSettings,
    align_points,
    align_splats,
)

__all__ = ["Alignment", "AlignmentSettings", "align_points", "align_splats"]
