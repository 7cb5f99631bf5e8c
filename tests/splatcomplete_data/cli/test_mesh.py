import pytest
import trimesh

from gscomplete.errors import UserError
from splatcomplete_data.cli.mesh import MeshOptions, make


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "ball.ply"
    trimesh.creation.icosphere(subdivisions=5).export(path)
    return path


def test_a_negative_seed_is_refused(ball):
    with pytest.raises(UserError, match="--seed: expected 0 to"):
        make(MeshOptions(file=ball, count=300, mode="random", seed=-1, prompt="a ball"))


@pytest.mark.parametrize(
    ("cut", "outline_px", "depth"),
    [
        ((), None, 0.5 * 2 / 512),
        (("plane:90",), None, 0.5 * 2 / 512),
        (("scan:0/20",), None, 0.0),
        (("scan:0/20",), 256.0, 0.5 * 2 / 256),
        ((), 0.0, 0.0),
    ],
)
def test_splats_lie_below_the_surface_unless_a_scanner_is_to_see_it(ball, cut, outline_px, depth):
    draft = make(MeshOptions(file=ball, count=10_000, cut=cut, outline_px=outline_px))
    found = 1.0 - draft.complete.means.double().norm(dim=1)
    # facets of the ball lie up to .0003 inside of it
    assert float(found.mean()) == pytest.approx(depth, abs=3e-4)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gltf_colors": "srgb"}, "--gltf-colors srgb: has no effect on .ply files"),
        ({"mode": "random", "outline_px": 300.0}, "--outline-px 300: .* with --mode random"),
        ({"mode": "grid", "outline_px": 0.0}, "--outline-px 0: has no effect with --mode grid"),
    ],
)
def test_options_without_effect_are_refused(ball, changes, message):
    with pytest.raises(UserError, match=message):
        make(MeshOptions(file=ball, count=300, **changes))
