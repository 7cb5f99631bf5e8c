"""Splat sets: the record, its file form, transforms and validation."""

from gscomplete.splats.filters import usable_rows
from gscomplete.splats.ply import SplatFile, append_splats, load_splats, read_splats, write_splats
from gscomplete.splats.ply_files.header import PlyError
from gscomplete.splats.record import SH_C0, Splats, colors_to_sh, concatenate
from gscomplete.splats.transform import Similarity, transform_splats

__all__ = [
    "SH_C0",
    "PlyError",
    "Similarity",
    "SplatFile",
    "Splats",
    "append_splats",
    "colors_to_sh",
    "concatenate",
    "load_splats",
    "read_splats",
    "transform_splats",
    "usable_rows",
    "write_splats",
]
