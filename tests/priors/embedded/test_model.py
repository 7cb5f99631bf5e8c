import dataclasses

import pytest
import torch

from gscomplete.priors.embedded.model import (
    FourViewDenoiser,
    ModelConfig,
    count_parameters,
    fold_cells,
    symmetric_copies,
)
from gscomplete.priors.embedded.rays import ring_rays
from gscomplete.render import render
from gscomplete.splats import Splats
from gscomplete.views import four_view_orbit
from tests.builders.tiny_denoiser import TINY, tiny_model


def inputs(batch=2, seed=0):
    g = torch.Generator().manual_seed(seed)
    size = TINY.resolution_px
    tokens = torch.tensor([[2, 3, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0]])
    return (
        torch.randn(batch, 4, 4, size, size, generator=g),
        torch.rand(batch, 4, 5, size, size, generator=g),
        torch.rand(batch, 4, 2, size, size, generator=g),
        torch.rand(batch, generator=g) * 999,
        torch.tensor([[20.0, 2.2, 40.0]]).repeat(batch, 1),
        tokens[:batch],
    )


@torch.no_grad()
def test_output_has_the_shape_of_the_images():
    given = inputs()
    assert tiny_model()(*given).shape == given[0].shape


@torch.no_grad()
def test_rings_of_a_batch_do_not_mix():
    model, given = tiny_model(), inputs()
    alone = model(*(part[:1] for part in given))
    torch.testing.assert_close(model(*given)[:1], alone, rtol=1e-4, atol=1e-5)


@torch.no_grad()
def test_turning_the_ring_turns_the_output():
    model = tiny_model()
    noisy, mapped, shape, at, ring, tokens = inputs()
    rays = ring_rays(ring, TINY.resolution_px // 2)
    plain = model(noisy, mapped, shape, at, ring, tokens, rays)
    torch.testing.assert_close(plain, model(noisy, mapped, shape, at, ring, tokens))
    for turn in (1, 2, 3):
        order = [(view + turn) % 4 for view in range(4)]
        maps = (noisy[:, order], mapped[:, order], shape[:, order])
        moved = model(*maps, at, ring, tokens, rays[:, order])
        torch.testing.assert_close(moved, plain[:, order], rtol=1e-4, atol=1e-5)


def test_cells_are_folded_as_a_pixel_unshuffle_folds_them():
    images = torch.rand(2, 4, 5, 16, 16)
    expected = torch.nn.functional.pixel_unshuffle(images, 2)
    assert torch.equal(fold_cells(images), expected)


def test_symmetric_copies_are_renders_of_turned_and_mirrored_objects():
    g = torch.Generator().manual_seed(0)
    count = 60
    splats = Splats(
        0.3 * torch.randn(count, 3, generator=g),
        torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
        torch.full((count, 3), 0.05),
        torch.full((count,), 0.8),
        torch.randn(count, 1, 3, generator=g),
    )
    cameras = four_view_orbit(30.0, 20.0, radius=2.2, fov_deg=40.0, size_px=16)
    quarter = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])

    def seen(matrix):
        moved = dataclasses.replace(splats, means=splats.means @ matrix.T)
        return render(moved, cameras).color.permute(0, 3, 1, 2)[None]

    def mirror(view):  # through the upright plane that holds the view's direction
        angle = torch.deg2rad(torch.tensor(30.0 + 90.0 * view))
        across = torch.stack([-torch.sin(angle), torch.cos(angle), torch.tensor(0.0)])
        return torch.eye(3) - 2 * torch.outer(across, across)

    folded = symmetric_copies(fold_cells(seen(torch.eye(3)))).flatten(0, 1)
    copies = torch.nn.functional.pixel_shuffle(folded, 2)[None]
    # Round splats, so moving the means moves the object; 1/255: alphas at the threshold may flip.
    for index, matrix in ((0, quarter), (1, quarter @ quarter)):
        copy = copies[:, :, 3 * index : 3 * index + 3]
        assert (copy - seen(matrix)).abs().max() <= 1 / 255, index
    for view in range(4):
        copy = copies[:, view, 9:12]
        assert (copy - seen(mirror(view))[:, view]).abs().max() <= 1 / 255, view


@torch.no_grad()
@pytest.mark.parametrize("part", range(6))
def test_every_input_matters(part):
    model, given, other = tiny_model(), list(inputs()), list(inputs(seed=1))
    other[4] = given[4] + torch.tensor([5.0, 0.2, 0.0])
    other[5] = given[5].flip(0)
    plain = model(*given)
    given[part] = other[part]
    assert float((model(*given) - plain).abs().max()) > 1e-4


@torch.no_grad()
def test_padding_of_the_prompt_does_not_matter():
    model, given = tiny_model(), inputs()
    shorter = (*given[:5], given[5][:, :3])
    torch.testing.assert_close(model(*given), model(*shorter), rtol=1e-4, atol=1e-5)


def test_text_reaches_every_view():
    model, given = tiny_model(), inputs(1)
    model.text.words.weight.grad = None
    model(*given)[:, 3].square().sum().backward()
    assert float(model.text.words.weight.grad[2].abs().sum()) > 0


def test_shipped_size_fits_the_package():
    with torch.device("meta"):
        count = count_parameters(FourViewDenoiser(ModelConfig()))
    assert 8e6 < count < 15e6
