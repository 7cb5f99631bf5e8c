"""The systems that results come from: how to run each, and which file it writes.

Conventions
-----------
* Inputs are those of the paper's comparison: the input view c for single-view systems; c and the
  views at azimuth offsets of 90 and 270 degrees, inpainted, for multi-view ones.
* ``up`` is the axis of the file that its system points up; alignment does not rely on it.
* What a system's own documentation says of its output is not checked here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Enters = Literal["mesh", "splats", "made here"]


@dataclass(frozen=True, slots=True)
class System:
    """One system."""

    name: str
    takes: str
    """What it is given."""
    gives: str
    """File that it writes."""
    enters: tuple[Enters, ...]
    """How its file is read; or that ``here`` makes it."""
    how: str
    """How to run it."""


_HERE = "python -m recipes.baselines.make --dataset DIR --out DIR"

SYSTEMS: dict[str, System] = {
    system.name: system
    for system in (
        System("mvdream", "the prompt", "splats (.ply) of gscomplete itself", ("splats",),
               "gscomplete complete OBJECT --prior mvdream --preset paper"),
        System("trellis", "image c with alpha, or three views", "GLB, or splats (.ply)",
               ("mesh", "splats"), "github.com/microsoft/TRELLIS: example.py, "
               "example_multi_image.py; postprocessing_utils.to_glb or Gaussian.save_ply"),
        System("trellis2", "image c with alpha", "GLB", ("mesh",),
               "github.com/microsoft/TRELLIS.2: example.py"),
        System("instantmesh", "image c", "OBJ with vertex colours", ("mesh",),
               "github.com/TencentARC/InstantMesh: run.py CONFIG IMAGE"),
        System("triposg", "image c", "GLB without colours", ("mesh",),
               "github.com/VAST-AI-Research/TripoSG: scripts.inference_triposg"),
        System("amodal3r", "image c and the mask of what hides it", "GLB, or splats (.ply)",
               ("mesh", "splats"), "github.com/Sm0kyWu/Amodal3R: example.py"),
        System("sam3d", "image c and its mask", "splats (.ply)", ("splats",),
               "github.com/facebookresearch/sam-3d-objects: demo.py"),
        System("partial", "P", "P as it is", ("made here",), _HERE),
        System("likeliest_mirror", "P, its up axis and views",
               "P and its mirror image through the plane proposed first", ("made here",), _HERE),
        System("best_mirror", "the same, and the truth to choose with",
               "P and the best of three mirror images", ("made here",), _HERE),
        System("nearest_mesh", "P, its up axis and views, a bank of meshes",
               "the bank's object nearest to P", ("made here",),
               f"{_HERE} --bank FILE; the file: python -m recipes.baselines.bank"),
        System("poisson", "P, its up axis and views",
               "P and what screened Poisson reconstruction closes it with", ("made here",), _HERE),
        System("other", "anything", "GLB, OBJ, PLY, .splat or .spz", ("mesh", "splats"),
               "any system that is not listed"),
    )
}  # fmt: skip
