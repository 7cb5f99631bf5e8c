"""What ``gscomplete complete`` can be asked for, and each object of ``gscomplete batch``."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gscomplete.errors import UserError
from gscomplete.priors.latent.settings import LatentPriorSettings


@dataclass(frozen=True, kw_only=True)
class HowToComplete:
    """The options of a completion that say neither which object nor where to."""

    prompt: str | None = None
    """Names the complete object, such as "a red mug"; None = as object.json says."""
    view: str | None = None
    """Input view c as AZIMUTH,ELEVATION in degrees (azimuth 0 looks from +x of the z-up object
    frame, 90 from +y); None = as object.json says, else guessed: the view that shows most of P from
    outside, or another one if the prior's guess of the complete object would hide P from it."""
    range: float | None = None
    """Degrees of azimuth that V extends to either side of c; None = as object.json says, else
    50."""
    up: str | None = None
    """Axis of the file that points up, X, Y, Z, -X, -Y or -Z (glTF: Y; COLMAP and most 3DGS files:
    -Y), or a direction X,Y,Z in file axes if the object leans, as leaning objects are completed
    badly; None = as object.json says, else Z."""
    center: str | None = None
    """Centre of the COMPLETE object as X,Y,Z in file coordinates; None = as object.json says if a
    user gave it there, else guessed from P."""
    size: Annotated[float | None, tyro.conf.arg(name="object-size")] = None
    """Largest side of the COMPLETE object in file units; None = as for --center."""
    prior: str = "embedded"
    """embedded, mvdream, or a path of weights: MVDream's file or folder, a folder of any diffusers
    text-to-image model, or an export of the embedded prior."""
    diffusion: LatentPriorSettings = dataclasses.field(default_factory=LatentPriorSettings)
    """Settings of latent diffusion priors (all but embedded)."""
    negative_prompt: str | None = None
    """Negative prompt, "" = none; None = the prior's default."""
    preset: Literal["default", "fast", "reconstruct", "distill", "paper"] = "default"
    """default: the best trade-off of time and quality for the prior. fast: quicker, less accurate.
    reconstruct: rounds of denoised views that the splats are fitted to. distill: score distillation
    in fewer steps than the paper's; with the embedded prior it starts from the prior's guess and
    changes colours only. paper: the paper's settings to the letter (6,000 steps), except that the
    sphere of new splats is about the (guessed) centre of the complete object, not of P's box."""
    steps: int | None = None
    """Optimiser steps; schedules, warm-up and pauses between subdivisions stretch with them. None =
    the preset's (the embedded prior's default takes none: its first guess is the result)."""
    preserve: str | None = None
    """Bounds COLOR,DEPTH on E_color and E_depth over V, such as 0.001,0.0005: at the end, new
    splats that hide P are faded, moved or removed until both bounds hold. None = the preset's."""
    fill: bool = False
    """P is complete except for gaps (scan shadows, slits, a hole under it): close these with a
    smooth surface and add nothing else. Uses no prior and needs no prompt."""
    edge_colors: Literal["auto", "trust", "ignore"] = "auto"
    """Colours at P's edges, which depth cameras mix with the background's: trust them in the guess,
    or ignore those unlike the colours further inside. auto = ignore where object.json says that a
    scanner or a depth camera saw P (subsets lidar and singleview)."""
    captured: Literal["auto", "yes", "no"] = "auto"
    """Whether P was trained from photos and nothing was cut off it. Then its outlines are the
    object's from where the photos were taken, and the guess keeps to those. auto = yes where
    object.json says so (subset multiview, without a complete object that P was cut from)."""
    leave_out_strays: bool = True
    """Guess nothing from P's strays: flying points of depth cameras, floaters and haze beside its
    surface, a patch of the table that it stands on. The output keeps them (--preset paper guesses
    from all of P)."""
    close_slits: bool = True
    """At the end, close the slits between the samples of a scan, which open wherever its surface
    leans away from the scanner (--preset paper leaves them open)."""
    match_seam: bool = False
    """At the end, shift the colours of new splats near P towards P's, to hide the seam."""
    mirror: str = "guess"
    """Upright plane that P is mirrored through: guess (bowls, bottles and the like are turned about
    their axis instead), none (the prior's answer alone), or AZIMUTH,OFFSET (azimuth of its normal
    in degrees, as in --view; distance from the frame's centre in object sizes). A run prints the
    plane that it used. cut: P is one half of a symmetric object, and only its mirror image in the
    plane that P ends at is added; if that takes the wrong plane, cut:AZIMUTH names the rough
    azimuth of the missing half."""
    known_shapes: bool = True
    """Let known shapes of the prompt's noun ("chair") that fit P help the guess where P alone does
    not determine it. A run prints those that it used."""
    prompt_decides: bool = False
    """Complete P to the known shape of the prompt's noun that fits it best, even if P alone
    suggests another object or seems complete: the same seat becomes "a stool" or "a table". If P
    has no colour of its own, new splats take the one that the prompt names ("a red mug")."""
    alternatives: int = 0
    """Also guess the complete object with this many likely mirror planes (at most 8) and with none,
    and draw these guesses below the result into alternatives.png, each with the --mirror value that
    selects it."""
    text_only: bool = False
    """Withhold renders of P from priors that can take them. The embedded prior sees the known shape
    of the prompt's noun that fits P best instead (with --no-known-shapes not even that)."""
    seed: int = 0
    """Random seed; the same seed gives the same bytes."""
    device: str = "auto"
    """cpu, cuda, cuda:1, or auto = cuda if there is one."""
    checkpoint_every: int | None = None
    """Steps between checkpoints; None = the preset's."""


@dataclass(frozen=True, kw_only=True)
class CompleteOptions(HowToComplete):
    """Complete a partial object made of Gaussian splats.

    Reads PARTIAL (P), adds new splats according to the prompt and the prior, keeps P's appearance
    from the view distribution V, and writes a run folder: completed.ply (P's records first, byte
    for byte, then the new ones), run.json, preview.png, turntable.webp. If PARTIAL is an object
    folder of splatcomplete-data or a file in one, its object.json supplies options not given.

    Examples: gscomplete complete half_mug.ply --prompt "a red mug" --out runs/mug;
    gscomplete complete objects/mug
    """

    partial: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PARTIAL")]
    """Splat file of the partial object: a PLY in the layout of the original 3DGS, or any format
    that splatcomplete-data convert reads (it is converted to PLY first); or an object folder."""
    out: Path | None = None
    """Run folder; None = the name of PARTIAL, or of its object folder, with _completed appended, in
    the current folder."""
    new_only: Path | None = None
    """Also write the new splats alone, in P's frame, to this PLY file, which must not exist."""
    resume: bool = False
    """Continue the run in --out from its last checkpoint; all other options must be the same."""
    profile: bool = False
    """Print time and memory by stage, and keep them as ``profile`` in run.json."""
    json: bool = False
    """Print only the content of run.json on standard output; messages go to standard error."""


def require_plain_fill(options: HowToComplete) -> None:
    """Refuse options that have no effect if only gaps are closed (``--fill``), before any is used.

    Raises:
        UserError: there is one.
    """
    heedless = {
        "--prior": options.prior != "embedded",
        "--diffusion": options.diffusion != LatentPriorSettings(),
        "--preset": options.preset != "default",
        "--steps": options.steps is not None,
        "--mirror": options.mirror != "guess",
        "--alternatives": options.alternatives != 0,
        "--no-known-shapes": not options.known_shapes,
        "--prompt-decides": options.prompt_decides,
        "--text-only": options.text_only,
        "--edge-colors": options.edge_colors != "auto",
        "--captured": options.captured != "auto",
        "--negative-prompt": options.negative_prompt is not None,
    }
    found = [name for name, given in heedless.items() if given]
    if found:
        raise UserError(f"--fill: closes gaps without a prior; expected no {', '.join(found)}")
