"""How far splats reach beyond a mesh is measured from its edges, in object sizes."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.util.optional import import_open3d
from gscomplete.views import ObjectFrame
from recipes.benchmarks.mesh_conversion import overhang
from splatcomplete_data.mesh.files.load import Mesh
from splatcomplete_data.mesh.files.parts import MeshPart
from tests.builders.objects import round_splats

SIGMA = 0.1
REACH = SIGMA * math.sqrt(2 * math.log(2))
"""Where half of the opacity is left."""


@pytest.mark.parametrize(("x", "beyond"), [(0.3, 0.0), (0.04, REACH - 0.04), (-0.3, REACH + 0.3)])
def test_overhang_of_one_splat(x, beyond):
    """A triangle of legs 4 in a frame that halves lengths, and a disc within, on, off its edge."""
    try:
        import_open3d("the test")
    except UserError as error:
        pytest.skip(str(error))
    corners = np.array([[[0, 0, 0], [4, 0, 0], [0, 4, 0]]], np.float32)
    mesh = Mesh((MeshPart(corners, np.ones_like(corners)),))
    splat = round_splats([[x, 0.5, 0.0]])
    disc = dataclasses.replace(splat, scales=torch.tensor([[SIGMA, SIGMA, 1e-4]]))
    frame = ObjectFrame("Z", (0.0, 0.0, 0.0), 2.0)
    assert overhang(disc, mesh, frame) == pytest.approx(beyond, abs=1e-5)
