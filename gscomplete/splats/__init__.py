"""Splat sets: the record, its file form, transforms and validation."""

from gscomplete.splats.record import SH_C0, Splats, colors_to_sh, concatenate

__all__ = ["SH_C0", "Splats", "colors_to_sh", "concatenate"]
