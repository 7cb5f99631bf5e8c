"""What ``gscomplete complete`` can be asked for, and each object of ``gscomplete batch``."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gscomplete.priors.latent.settings import LatentPriorSettings


@dataclass(frozen=True, kw_only=True)
class HowToComplete:
    """The options of a completion that say neither which object nor where to."""

    prompt: str | None = None
    """What the complete object is, such as "a red mug"; None = as object.json says."""
    view: str | None = None
    """Input view c as AZIMUTH,ELEVATION in degrees (azimuth 0 looks from +x of the z-up object
    frame, 90 from +y); None = as object.json says, else the view that shows most of P from
    outside, or another if the prior's guess of the complete object would hide P from there."""
    range: float | None = None
    """V reaches this many degrees of azimuth to either side of c; None = as object.json says, else
    50."""
    up: str | None = None
    """Axis of the file that points up, X, Y, Z, -X, -Y or -Z (glTF: Y; COLMAP and most 3DGS files:
    -Y), or a direction X,Y,Z in file axes, as objects that lean are completed badly; None = as
    object.json says, else Z."""
    center: str | None = None
    """Centre of the COMPLETE object as X,Y,Z in file coordinates; None = as object.json says where
    it was given to that by hand, else guessed from P."""
    size: Annotated[float | None, tyro.conf.arg(name="object-size")] = None
    """Largest side of the COMPLETE object in file units; None = as for --center."""
    prior: str = "embedded"
    """embedded, mvdream, or the path of weights: MVDream's file or folder, a folder of any
    diffusers text-to-image model, or an export of the embedded prior."""
    diffusion: LatentPriorSettings = dataclasses.field(default_factory=LatentPriorSettings)
    """Knobs of latent diffusion priors (all but embedded)."""
    negative_prompt: str | None = None
    """What to lead away from, "" = nothing; None = the prior's default."""
    preset: Literal["default", "fast", "reconstruct", "distill", "paper"] = "default"
    """default: best of time and quality for the prior. fast: less care. reconstruct: rounds of
    denoised views that the splats are fitted to. distill: score distillation in fewer steps
    than the paper's; with the embedded prior of colours alone, from its guess.
    paper: the paper's settings to the letter (6,000 steps); its sphere of new splats is about
    P's box centre, here about the (guessed) centre of the complete object."""
    steps: int | None = None
    """Optimiser steps; schedules, warm-up and pauses between subdivisions stretch with it. None =
    the preset's (the embedded prior's default takes none: its first guess is the result)."""
    preserve: str | None = None
    """Bounds COLOR,DEPTH on E_color and E_depth over V, such as 0.001,0.0005: at the end, new
    splats that hide P fade, move or go until both hold. None = what the preset gives."""
    fill: bool = False
    """P is complete but for gaps (scan shadows, slits, a hole under it): close these by a smooth
    surface and add nothing else. Takes no prior's guess, and needs no prompt."""
    close_slits: bool = True
    """At the end, close the slits between the samples of a scan, which open wherever its surface
    leans away from the scanner (--preset paper leaves them)."""
    match_seam: bool = False
    """At the end, shift new splats' colours near P towards P's, so that no seam shows."""
    mirror: str = "guess"
    """Upright plane that P is mirrored through: guess, none, or AZIMUTH,OFFSET (of its normal in
    degrees as in --view; from the frame's centre in object sizes). A run prints the one it took.
    cut: P is one half of a symmetric object, whose image through the plane that P ends at is all
    that is added; cut:AZIMUTH says towards which azimuth, roughly, if another plane was taken."""
    known_shapes: bool = True
    """Let known shapes of the prompt's noun ("chair") that suit P help the guess where P leaves it
    open. A run prints which did."""
    prompt_decides: bool = False
    """Complete P by the known shape of the prompt's noun that suits it best, even where P alone
    says otherwise or seems complete: the same seat becomes "a stool" or "a table". Where P has no
    colour of its own, new splats take the one that the prompt names ("a red mug")."""
    alternatives: int = 0
    """Also guess the complete object through this many likely planes (at most 8) and through none,
    and draw these guesses below the result into alternatives.png, each with the --mirror that makes
    a run take it."""
    text_only: bool = False
    """Withhold P's renders from priors that can see them. The embedded prior is shown a known shape
    of the prompt's noun instead, the one that suits P best (--no-known-shapes: not even that)."""
    seed: int = 0
    """Same seed, same bytes."""
    device: str = "auto"
    """cpu, cuda, cuda:1, or auto = cuda if there is one."""
    checkpoint_every: int | None = None
    """Steps between checkpoints; None = the preset's."""


@dataclass(frozen=True, kw_only=True)
class CompleteOptions(HowToComplete):
    """Complete a partial object made of Gaussian splats.

    Reads PARTIAL (P), adds new splats where the prompt and the prior want them, keeps P's
    appearance from the view distribution V, and writes a run folder: completed.ply (P's records
    first and byte for byte, new ones after), run.json, preview.png, turntable.webp. Of an object
    folder of splatcomplete-data, or any file in it, object.json says what the options leave open.

    Examples: gscomplete complete half_mug.ply --prompt "a red mug" --out runs/mug;
    gscomplete complete objects/mug
    """

    partial: Annotated[Path, tyro.conf.Positional]
    """Splat file of the partial object: a PLY in the layout of the original 3DGS, or any format
    that splatcomplete-data convert reads, which is converted to PLY first; or an object folder."""
    out: Path | None = None
    """Run folder; None = the name of PARTIAL or of its object with _completed, in the current
    folder."""
    new_only: Path | None = None
    """PLY file to write the new splats to as well, alone, in P's frame; it must not exist."""
    resume: bool = False
    """Continue the run in --out from its last checkpoint; all other options must be the same."""
    profile: bool = False
    """Print where time and memory went, stage by stage, and keep it as ``profile`` in run.json."""
    json: bool = False
    """Print the content of run.json on standard output and nothing else there."""
