"""OpenUSD's own library reads back what was written, and finds it valid."""

from pathlib import Path

import numpy as np
import pytest
import torch

from gscomplete.splats import transform_splats
from gscomplete.splats.formats.any_file import write_any_splats
from gscomplete.splats.formats.glb import TURN
from tests.splats.formats.test_any_file import some_splats


@pytest.mark.parametrize("kind", ["usda", "usdc", "usd"])
def test_usd_holds_all_that_splats_have(tmp_path: Path, kind: str) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdVol

    splats = some_splats(7, 16)
    path = tmp_path / f"a.{kind}"
    assert write_any_splats(path, splats) == ()
    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y
    prim = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    assert prim.GetPrim().IsA(UsdVol.ParticleField)
    expected = transform_splats(splats, TURN)
    turned = [(q.GetReal(), *q.GetImaginary()) for q in prim.GetOrientationsAttr().Get()]
    values = {
        "means": (prim.GetPositionsAttr().Get(), expected.means),
        "quaternions": (turned, expected.quaternions),
        "scales": (prim.GetScalesAttr().Get(), expected.scales),
        "opacities": (prim.GetOpacitiesAttr().Get(), expected.opacities),
    }
    for name, (found, wanted) in values.items():
        np.testing.assert_allclose(np.array(found), wanted.numpy(), atol=1e-6, err_msg=name)
    assert prim.GetRadianceSphericalHarmonicsDegreeAttr().Get() == 3
    found = np.array(prim.GetRadianceSphericalHarmonicsCoefficientsAttr().Get())
    np.testing.assert_allclose(found.reshape(7, 16, 3), expected.sh.numpy(), atol=1e-6)
    low, high = (torch.tensor(list(corner)) for corner in prim.GetExtentAttr().Get())
    assert (low < expected.means.amin(dim=0)).all()
    assert (high > expected.means.amax(dim=0)).all()
