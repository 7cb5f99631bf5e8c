"""Write OpenUSD: one ``ParticleField3DGaussianSplat`` (OpenUSD 26.03 and later), through usd-core.

Conventions
-----------
* ``.usda`` is text, ``.usd`` and ``.usdc`` are binary. The stage is y-up in units of 1 m, and
  functions here use its axes.
* Positions, linear scales, opacities (0 to 1), quaternions and harmonics are float: nothing is
  lost. Harmonics lie splat by splat, in the order and with the sign of 3DGS.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from gscomplete.errors import UserError
from gscomplete.splats.record import Splats
from gscomplete.util.atomic import atomic_path
from gscomplete.util.optional import import_optional

_PRIM = "/Splats"
_EXTENT_SIGMAS = 3.0
"""The extent holds every splat out to so many standard deviations."""


def write_usd(path: Path, splats: Splats) -> None:
    """Write splats, y up, as a stage with one prim.

    Raises:
        UserError: usd-core is missing, or the file cannot be written.
    """
    purpose = f"writing {path.suffix} files"
    usd, geom, volume = (
        import_optional(f"pxr.{name}", purpose) for name in ("Usd", "UsdGeom", "UsdVol")
    )
    array = import_optional("pxr.Vt", purpose)
    means = np.ascontiguousarray(splats.means.numpy(), np.float32)
    reach = _EXTENT_SIGMAS * splats.scales.amax(dim=1, keepdim=True).numpy()
    extent = np.stack([(means - reach).min(axis=0), (means + reach).max(axis=0)])
    xyzw = np.ascontiguousarray(splats.quaternions.numpy()[:, [1, 2, 3, 0]], np.float32)
    harmonics = np.ascontiguousarray(splats.sh.reshape(-1, 3).numpy(), np.float32)
    with atomic_path(path) as temporary:
        stage = usd.Stage.CreateNew(str(temporary))
        geom.SetStageUpAxis(stage, geom.Tokens.y)
        geom.SetStageMetersPerUnit(stage, 1.0)
        prim = volume.ParticleField3DGaussianSplat.Define(stage, _PRIM)
        stage.SetDefaultPrim(prim.GetPrim())
        prim.CreatePositionsAttr(array.Vec3fArray.FromNumpy(means))
        prim.CreateOrientationsAttr(array.QuatfArray.FromNumpy(xyzw))
        prim.CreateScalesAttr(array.Vec3fArray.FromNumpy(splats.scales.float().numpy()))
        opacities = splats.opacities.float().clamp(0, 1).numpy()
        prim.CreateOpacitiesAttr(array.FloatArray.FromNumpy(opacities))
        prim.CreateRadianceSphericalHarmonicsDegreeAttr(splats.sh_degree)
        prim.CreateRadianceSphericalHarmonicsCoefficientsAttr(array.Vec3fArray.FromNumpy(harmonics))
        prim.CreateExtentAttr(array.Vec3fArray.FromNumpy(extent.astype(np.float32)))
        try:
            stage.GetRootLayer().Save()
        except RuntimeError as error:  # USD's own, of several lines, the reason in quotes
            reason = re.search(r" : '([^']*)'", str(error))
            text = reason[1] if reason else str(error).strip()
            raise UserError(f"{path}: cannot write: {text}") from error
