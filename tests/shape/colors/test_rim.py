import numpy as np
import pytest
import torch

from gscomplete.shape.colors import rim
from gscomplete.shape.colors.rim import checked_by_rim
from tests.builders.objects import ball, half, round_splats


def two_bands(points):
    """Return white above and black below."""
    return (points[:, 2:] > 0).float().expand(-1, 3)


def checked(shown, partial, points, normals, sure=None):
    sure = torch.zeros(len(points)) if sure is None else sure
    return checked_by_rim(shown, sure, points, normals, partial, torch.Generator().manual_seed(0))


def test_what_a_mirror_image_shows_again_gives_way_to_the_rim():
    """Half a ball, white above and black below, whose far side a copy gives a red face."""
    directions = torch.randn(6000, 3, generator=torch.Generator().manual_seed(0))
    means = 0.4 * torch.nn.functional.normalize(directions, dim=1)
    whole = round_splats(means, color=two_bands(means))
    seen = whole.means[:, 0] > 0
    partial, hidden = whole.select(seen), whole.means[~seen]
    normals = torch.nn.functional.normalize(hidden, dim=1)
    bands = two_bands(hidden)
    away = hidden[:, 2].abs() > 0.1
    assert float((checked(bands, partial, hidden, normals) - bands)[away].abs().mean()) < 0.02
    face = (hidden - torch.tensor([-0.37, 0.0, 0.15])).norm(dim=1) < 0.1
    shown = torch.where(face[:, None], torch.tensor([1.0, 0.0, 0.0]), bands)
    found = checked(shown, partial, hidden, normals)
    assert float((found - bands)[away & ~face].abs().mean()) < 0.04
    assert float((found - bands)[face & away].abs().mean()) < 0.1  # of the copy: 0.67
    sure = torch.ones(len(hidden))
    assert torch.equal(checked(shown, partial, hidden, normals, sure), shown)
    half_sure = checked(shown, partial, hidden, normals, sure / 2)
    torch.testing.assert_close(
        half_sure[face & away], ((shown + found) / 2)[face & away], atol=0.01, rtol=0
    )


def test_what_no_rim_reaches_keeps_its_colours():
    partial, points = half(ball()), ball().means
    points = points[points[:, 0] < -0.2][:200]
    shown = torch.rand(len(points), 3)
    normals = torch.nn.functional.normalize(points, dim=1)
    away = points - torch.tensor([5.0, 0.0, 0.0])
    assert torch.equal(checked(shown, partial, away, normals), shown)
    assert torch.equal(checked(shown[:3], partial, points[:3], normals[:3]), shown[:3])
    apart = torch.cat([points, away])
    found = checked(shown.repeat(2, 1), partial, apart, normals.repeat(2, 1))
    torch.testing.assert_close(found[len(points) :], shown)


@pytest.mark.parametrize("spacing", [0.01, 0.02])
def test_means_are_over_the_same_reach_however_dense_the_splats(spacing):
    steps = np.arange(-0.4, 0.4 + spacing / 2, spacing)
    places = np.stack([*np.meshgrid(steps, steps), np.zeros((len(steps),) * 2)], axis=-1)
    places = places.reshape(-1, 3)
    graph = rim._neighbour_weights(places, np.tile([0.0, 0.0, 1.0], (len(places), 1)))
    off = np.linalg.norm(places, axis=1)
    found = rim._averaged((off == off.min()).astype(np.float64), graph, places)
    assert found.sum() == pytest.approx(1.0, rel=0.01)  # borders lose a little
    spread = np.sqrt((found * places[:, 0] ** 2).sum())
    assert spread == pytest.approx(rim._AVERAGED_REACH / np.sqrt(2), rel=0.05)  # along one axis
