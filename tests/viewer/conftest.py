"""A running viewer."""

import pytest

from gscomplete.viewer.layers import Layer, Scene
from gscomplete.viewer.server import serve
from gscomplete.views import ViewDistribution
from tests.builders.objects import random_splats


@pytest.fixture
def viewer():
    pytest.importorskip("viser")
    layers = (
        Layer("P", random_splats(30), ""),
        Layer("new", random_splats(20, seed=1), ""),
        Layer("--mirror=none", random_splats(10, seed=2), "", is_alternative=True),
    )
    started = serve(Scene(layers, ViewDistribution(30.0, 15.0)), "127.0.0.1", 18080)
    yield started
    started.server.stop()
