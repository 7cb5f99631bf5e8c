"""Splat files through readers and writers that others wrote, both ways.

``python -m recipes.benchmarks.formats.round_trips --splat-transform PATH`` writes splats in every
format, has them read by another program, and the other way round, and compares with what was
written: positions over the scene's size, rotations, log scales, opacities, base colours, and
harmonics.

* ``splat-transform``: PlayCanvas' converter (``npm install @playcanvas/splat-transform``); PATH is
  its ``bin/cli.mjs``. It reads what we write to a PLY, and writes what we read.
* ``usd-core``: OpenUSD's library reads what we write (``pip install "gscomplete[usd]"``).
* ``gsply``: reads our PLY and compressed PLY.

Every largest error stands beside its limit, what the format's coding can explain (``LIMITS``). The
exit code is 1 where one lies beyond.
"""

from __future__ import annotations

import math
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree

from gscomplete.errors import UserError
from gscomplete.splats import Splats, read_splats, transform_splats, write_splats
from gscomplete.splats.formats import glb
from gscomplete.splats.formats.any_file import read_any_splats, write_any_splats
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.util.optional import import_optional
from recipes.entry_point import start

_TIMEOUT_S = 300


@dataclass(frozen=True)
class Limits:
    """Largest error of a format."""

    position: float
    """Over the largest side of all positions."""
    rotation_deg: float
    log_scale: float
    opacity: float
    color: float
    """Of sRGB base colours."""


LIMITS = {
    "ply": Limits(1e-6, 0.05, 1e-5, 1e-5, 1e-5),
    "glb": Limits(1e-6, 0.05, 1e-5, 1e-5, 1e-5),
    "usdc": Limits(1e-6, 0.05, 1e-5, 1e-5, 1e-5),
    # 16 bits of signed log positions, 8 bits of rotations, 256 shared scales and colours
    "sog": Limits(5e-4, 2.0, 0.05, 0.01, 0.05),
    # 11, 10 and 11 bits within chunks of 256; 10 bits of rotations; 8 of colours
    "compressed.ply": Limits(1e-3, 0.4, 0.01, 0.01, 0.02),
    # 24 bits with 12 of fraction; 10 bits of rotations; 8 of the rest, colours over a range of 6.7
    "spz": Limits(1e-4, 0.5, 0.04, 0.01, 0.02),
    # float32; 8 bits of rotations, opacities and colours
    "splat": Limits(1e-6, 2.0, 1e-5, 0.01, 0.01),
}


@dataclass(frozen=True)
class Options:
    """Compare splat files with what other programs make of them."""

    splat_transform: Path | None = None
    """bin/cli.mjs of @playcanvas/splat-transform; None = leave it out."""
    file: Path | None = None
    """Splats to convert; None = random ones."""
    count: int = 3_000
    """Random splats."""
    degree: int = 3
    """Their degree of spherical harmonics."""


def random_splats(count: int, degree: int) -> Splats:
    """Return random splats of base colours that every format can hold."""
    generator = torch.Generator().manual_seed(2)
    sh = 0.2 * torch.randn(count, (degree + 1) ** 2, 3, generator=generator)
    return Splats(
        torch.randn(count, 3, generator=generator),
        torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=1),
        (0.3 * torch.randn(count, 3, generator=generator) - 3).exp(),
        torch.rand(count, generator=generator).clamp(0.02, 0.98),
        sh,
    )


class Report:
    """Rows of errors beside their limits."""

    def __init__(self) -> None:
        self.misses = 0

    def compare(self, name: str, kind: str, wanted: Splats, found: Splats) -> None:
        """Match splats by position, measure, and write a row."""
        if len(found) != len(wanted):
            self.misses += 1
            sys.stdout.write(f"{name}: {len(found):,} splats for {len(wanted):,}\n")
            return
        away, row = cKDTree(found.means.numpy()).query(wanted.means.numpy())
        found = found.select(torch.from_numpy(row))
        size = float((wanted.means.amax(dim=0) - wanted.means.amin(dim=0)).max())
        errors = Limits(
            float(away.max()) / size,
            _largest_turn(wanted, found),
            float((wanted.scales.log() - found.scales.log()).abs().max()),
            float((wanted.opacities - found.opacities).abs().max()),
            float((wanted.base_colors - found.base_colors).abs().max()),
        )
        limits = LIMITS[kind]
        parts, within = [], True
        for key in Limits.__dataclass_fields__:
            error, limit = getattr(errors, key), getattr(limits, key)
            within &= error <= limit
            parts.append(f"{key} {error:.2g} ({limit:g})")
        shared = min(found.sh.shape[1], wanted.sh.shape[1])
        lost = "" if shared == wanted.sh.shape[1] else ", harmonics left out"
        if shared > 1:
            mean = float((wanted.sh[:, 1:shared] - found.sh[:, 1:shared]).abs().mean())
            lost = f", harmonics off by {mean:.2g} on average"
        self.misses += not within
        verdict = "within" if within else "BEYOND"
        sys.stdout.write(f"{name}: {verdict}: {', '.join(parts)}{lost}\n")
        sys.stdout.flush()


def _largest_turn(wanted: Splats, found: Splats) -> float:
    """Return the largest angle between rotations in degrees, half turns about an axis apart.

    An ellipsoid turned by 180 degrees about one of its own axes is the same.
    """
    turn = rotation_matrices(wanted.quaternions.double()).mT @ rotation_matrices(
        found.quaternions.double()
    )
    traces = [turn.diagonal(dim1=1, dim2=2).sum(dim=1)]
    for axis in range(3):
        half = -torch.ones(3, dtype=torch.float64)
        half[axis] = 1.0
        traces.append((turn.diagonal(dim1=1, dim2=2) * half).sum(dim=1))
    cosine = ((torch.stack(traces).amax(dim=0) - 1) / 2).clamp(-1, 1)
    return math.degrees(float(cosine.arccos().max()))


def by_splat_transform(report: Report, cli: Path, splats: Splats, folder: Path) -> None:
    """Have splat-transform read what we write, and read what it writes."""
    source, back = folder / "source.ply", folder / "back.ply"
    write_splats(source, splats)
    for kind in ("sog", "compressed.ply", "spz", "splat", "glb"):
        if kind != "glb":  # it reads none
            ours = folder / f"ours.{kind}"
            write_any_splats(ours, splats)
            _transform(cli, ours, back)
            found = read_splats(back).splats
            report.compare(f"{kind}, ours read by splat-transform", kind, splats, found)
        if kind != "splat":  # it writes none
            theirs = folder / f"theirs.{kind}"
            _transform(cli, source, theirs)
            found = read_any_splats(theirs).splats
            report.compare(f"{kind}, splat-transform's read by ours", kind, splats, found)


def _transform(cli: Path, source: Path, target: Path) -> None:
    """Run splat-transform.

    Raises:
        UserError: Node.js is missing, or it fails.
    """
    node = shutil.which("node")
    if node is None:
        raise UserError("--splat-transform: expected Node.js (node) on the path, found none")
    command = [node, str(cli), "-q", "-w", "-g", "cpu", "--max-workers", "0"]
    command += [str(source), str(target)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
    if run.returncode:
        last = run.stderr.strip()[-300:]
        raise UserError(f"{cli}: {source.name} to {target.name} failed: {last}")


def by_usd_core(report: Report, splats: Splats, folder: Path) -> None:
    """Have OpenUSD read what we write."""
    pxr = import_optional("pxr.UsdVol", "reading USD back")
    from pxr import Usd

    path = folder / "ours.usdc"
    write_any_splats(path, splats)
    stage = Usd.Stage.Open(str(path))
    prim = pxr.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    turned = [(q.GetReal(), *q.GetImaginary()) for q in prim.GetOrientationsAttr().Get()]
    harmonics = np.array(prim.GetRadianceSphericalHarmonicsCoefficientsAttr().Get(), np.float32)
    found = Splats(
        *(
            torch.from_numpy(np.array(values, np.float32))
            for values in (
                prim.GetPositionsAttr().Get(),
                turned,
                prim.GetScalesAttr().Get(),
                prim.GetOpacitiesAttr().Get(),
                harmonics.reshape(len(splats), -1, 3),
            )
        )
    )
    wanted = transform_splats(splats, glb.TURN)
    report.compare("usdc, ours read by usd-core", "usdc", wanted, found)


def by_gsply(report: Report, splats: Splats, folder: Path) -> None:
    """Have gsply read our PLY and compressed PLY."""
    gsply = import_optional("gsply", "reading PLY back")
    for kind in ("ply", "compressed.ply"):
        path = folder / f"gsply.{kind}"
        write_any_splats(path, splats)
        data = gsply.plyread(str(path))
        again = folder / "again.ply"
        gsply.plywrite(str(again), data)
        report.compare(f"{kind}, ours read by gsply", kind, splats, read_splats(again).splats)


def main(options: Options) -> int:
    """Compare; return 1 where something lies beyond its limit."""
    if options.file is None:
        splats = random_splats(options.count, options.degree)
    else:
        splats = read_any_splats(options.file).splats
    report = Report()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        by_gsply(report, splats, folder)
        by_usd_core(report, splats, folder)
        if options.splat_transform is not None:
            by_splat_transform(report, options.splat_transform, splats, folder)
    return 1 if report.misses else 0


if __name__ == "__main__":
    start(main, Options, __doc__)
