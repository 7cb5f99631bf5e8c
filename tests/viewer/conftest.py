"""A running viewer."""

import pytest

from gscomplete.viewer.layers import Layer, Scene
from gscomplete.viewer.server import serve
from gscomplete.views import ViewDistribution
from tests.splats.ply_files import make_splats


@pytest.fixture
def viewer():
    pytest.importorskip("viser")
    layers = (Layer("P", make_splats(30), ""), Layer("new", make_splats(20, seed=1), ""))
    started = serve(Scene(layers, ViewDistribution(30.0, 15.0)), "127.0.0.1", 18080)
    yield started
    started.server.stop()
