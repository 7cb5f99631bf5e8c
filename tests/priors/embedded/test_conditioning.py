import math

import numpy as np
import pytest
import torch

from gscomplete.priors.base import FourViews
from gscomplete.priors.embedded.conditioning import EmbeddedConditioning, about_partial, upright
from gscomplete.priors.embedded.prior import EmbeddedPrior
from gscomplete.shape.bank.fit import FittedShape
from gscomplete.shape.bank.pose import Pose
from gscomplete.shape.bank.store import BANK_FILE, ShapeName, write_bank
from gscomplete.splats import Splats
from gscomplete.views import ViewDistribution, four_view_orbit
from tests.builders.known_shapes import box_cells, cell_points, chair_cells
from tests.builders.tiny_denoiser import ring_views, tiny_config, tiny_model

CHAIR = ShapeName("a/chair", "chair", "a chair")


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    path = tmp_path_factory.mktemp("bank") / BANK_FILE
    names = [CHAIR, ShapeName("b/box", "box", "a box")]
    write_bank(path, names, [chair_cells(), box_cells((8, 48, 48), at=(20, 0, 0))])
    return path


@pytest.fixture(scope="module")
def prior(bank):
    return EmbeddedPrior(tiny_model(), tiny_config(), precision="float32", bank=bank)


def told(prompt="a chair"):
    return EmbeddedConditioning(*(torch.tensor([k]) for k in (2, 1, 2)), ("read",), prompt)


def blank(size_px=16):
    cameras = four_view_orbit(0.0, 10.0, radius=2.2, fov_deg=40.0, size_px=size_px)
    zeros = torch.zeros(4, size_px, size_px)
    return FourViews(torch.zeros(4, size_px, size_px, 3), zeros, zeros, cameras)


def test_no_shape_is_zeros():
    assert not told().shape_map(blank(), 2.2, 16).any()


def test_a_shape_is_seen_from_the_rings_cameras(bank):
    seen = upright(told(), bank, 1).shape_map(blank(64), 2.2, 32)
    assert seen.shape == (4, 2, 32, 32)
    area = seen[:, 0].sum(dim=(1, 2))
    # a slab that is thin along x: broad from +x and -x, narrow from +y and -y
    assert area[0] > 3 * area[1]
    assert area[2] > 3 * area[3]
    middle = seen[:, 1, 15:17, 15:17].mean(dim=(1, 2))
    assert float(middle[1]) > float(middle[0]) > 0  # its ends stand out farther than its faces


def test_the_users_report_names_the_shape(bank):
    assert upright(told(), bank, 0).report == (
        "read",
        "prompt: the prior sees the known shape a/chair",
    )


def test_a_fitted_shape_stays_where_it_is(bank):
    cells = chair_cells()
    pose = Pose(0.0, np.full(3, 2.0), np.zeros(3))  # half as large as in its own frame
    points = cell_points(cells) / 2
    fitted = FittedShape(CHAIR, cells, pose, points, 0.0, 0.0, 0.0, 0.0)
    placed = about_partial(told(), fitted)
    assert np.allclose(placed.shape.means.numpy(), points, atol=1e-6)
    whole = upright(told(), bank, 0)
    assert np.allclose(placed.shape.scales.numpy() * 2, whole.shape.scales.numpy(), atol=1e-7)


def part_of_a_chair():
    points = cell_points(chair_cells())
    points = torch.from_numpy(points[points[:, 2] > 0.0]).float()
    count = len(points)
    turn = torch.zeros(count, 4)
    turn[:, 0] = 1
    return Splats(
        points, turn, torch.full((count, 3), 0.02), torch.ones(count), torch.zeros(count, 1, 3)
    )


def views():
    return ViewDistribution(0.0, math.degrees(0.3))


def test_the_prior_places_the_shape_of_the_noun_by_p(prior):
    known = prior.with_known_shape(prior.condition("a red chair"), part_of_a_chair(), views())
    assert "a/chair" in known.report[-1]
    low, high = known.shape.bounds()
    assert float(low[2]) < -0.4  # it has the legs that P lacks
    assert float(high[2]) < 0.55


def test_without_a_known_shape_nothing_changes(prior):
    given = prior.condition("a mug")
    assert prior.with_known_shape(given, part_of_a_chair(), views()) is given


def test_the_shape_decides_what_is_denoised(prior, bank):
    plain = prior.condition("chair")
    images = ring_views(16)

    def loss(words):
        generator = torch.Generator().manual_seed(0)
        return float(prior.distill(images, 500.0, words, generator))

    assert loss(plain) == loss(plain)
    assert loss(upright(plain, bank, 0)) != loss(plain)
    assert loss(upright(plain, bank, 0)) != loss(upright(plain, bank, 1))
