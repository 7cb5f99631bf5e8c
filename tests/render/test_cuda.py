"""The CUDA renderer without a GPU: what is passed to gsplat, and what is said when it fails.

gsplat is replaced by a function with its signature (version 1.5) that draws with the float64
reference renderer, so that everything but gsplat's kernels is tested, gradients included.
"""

import inspect
import sys
import types

import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.render import RenderSettings, cuda, reference, render
from gscomplete.render.dispatch import choose_render_device
from gscomplete.splats import Splats
from gscomplete.util.device import choose_device
from gscomplete.views import Cameras, orbit_cameras
from tests.builders.objects import random_splats


def rasterization(
    means,
    quats,
    scales,
    opacities,
    colors,
    viewmats,
    Ks,
    width,
    height,
    near_plane=0.01,
    far_plane=1e10,
    radius_clip=0.0,
    eps2d=0.3,
    sh_degree=None,
    packed=True,
    tile_size=16,
    backgrounds=None,
    render_mode="RGB",
    sparse_grad=False,
    absgrad=False,
    rasterize_mode="classic",
):
    """gsplat's function over the reference renderer."""
    assert render_mode == "RGB+D"
    assert not packed
    assert colors.shape[1] == (sh_degree + 1) ** 2
    tensors = (means, quats, scales, opacities, colors, viewmats, Ks)
    assert {t.device for t in tensors} == {means.device}
    assert {t.dtype for t in tensors} == {torch.float32}
    focal = torch.stack([Ks[:, 0, 0], Ks[:, 1, 1]], dim=1)
    cameras = Cameras(viewmats, focal, Ks[:, :2, 2], width, height)
    centers = torch.zeros(len(viewmats), len(means), 2, requires_grad=True)
    drawn = reference.rasterize(
        Splats(means, quats, scales, opacities, colors),
        cameras,
        None,
        centers * 1.0,
        RenderSettings(near=near_plane, blur_px2=eps2d),
    )
    summed_depth = (drawn.depth * drawn.alpha)[..., None]
    colors = torch.cat([drawn.color, summed_depth], dim=-1)
    return colors.float(), drawn.alpha[..., None].float(), {"means2d": centers}


@pytest.fixture
def gsplat(monkeypatch):
    module = types.ModuleType("gsplat")
    module.rasterization = rasterization
    monkeypatch.setitem(sys.modules, "gsplat", module)
    return module


def leaves(made: Splats) -> Splats:
    return Splats(**{name: value.clone().requires_grad_() for name, value in made.fields()})


def test_same_picture_and_gradients_as_the_reference(gsplat):
    cameras = orbit_cameras(
        torch.tensor([0.0, 80.0]), torch.tensor([10.0, -20.0]), radius=2, fov_deg=40, size_px=24
    )
    frozen, drawn = random_splats(20, 1, 1), {}
    g = torch.Generator().manual_seed(0)
    weights = torch.randn(2, 24, 24, 3, generator=g)
    for backend in ("cuda", "reference"):
        new = leaves(random_splats(15, 1, 2))
        offsets = torch.zeros(2, 15, 2, requires_grad=True)
        picture = render(
            new, cameras, torch.ones(3), frozen=frozen, screen_offsets=offsets, backend=backend
        )
        loss = (picture.color * weights).sum() + picture.depth.sum() + picture.alpha.sum()
        loss.backward()
        gradients = [value.grad for _, value in new.fields()] + [offsets.grad]
        drawn[backend] = ([picture.color, picture.alpha, picture.depth], gradients)
    for one, other in zip(drawn["cuda"], drawn["reference"], strict=True):
        for a, b in zip(one, other, strict=True):
            torch.testing.assert_close(a, b.float(), rtol=2e-4, atol=2e-4)
    assert all(value.grad is None for _, value in frozen.fields())
    assert float(drawn["cuda"][1][-1].abs().max()) > 0, "densification has its statistics"


def test_the_real_gsplat_takes_these_arguments():
    gsplat = pytest.importorskip("gsplat", reason="gsplat is not installed (no GPU here)")
    ours = inspect.signature(rasterization).parameters
    theirs = inspect.signature(gsplat.rasterization).parameters
    assert list(ours) == list(theirs)[: len(ours)]


def test_settings_that_its_kernels_fix_are_refused(gsplat):
    cameras = orbit_cameras(torch.zeros(1), torch.zeros(1), radius=2, fov_deg=40, size_px=8)
    with pytest.raises(UserError, match=r"alpha_max is 0\.999 in gsplat"):
        render(random_splats(2), cameras, settings=RenderSettings(alpha_max=0.99), backend="cuda")


def test_check_passes_where_gsplat_draws(gsplat):
    cuda.check_cuda_renderer(torch.device("cpu"))


@pytest.mark.parametrize(
    "failure", [RuntimeError("nvcc not found\nlong log"), AttributeError("'NoneType'"), None]
)
def test_check_names_the_reason_in_one_line(gsplat, monkeypatch, failure):
    def broken(*arguments, **more):
        if failure is not None:
            raise failure
        colors, alphas, meta = rasterization(*arguments, **more)
        return colors * 0, alphas * 0, meta

    monkeypatch.setattr(gsplat, "rasterization", broken)
    with pytest.raises(UserError, match="cannot be used here") as caught:
        cuda.check_cuda_renderer(torch.device("cpu"))
    assert "\n" not in str(caught.value)
    assert "long log" not in str(caught.value)


def test_absence_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(UserError, match=r"install the extra gscomplete\[cuda\]"):
        cuda.check_cuda_renderer(torch.device("cpu"))


def test_only_auto_falls_back_to_the_cpu_renderer(monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)
    gpu = torch.device("cuda")
    # the check builds its splat on the device, which this machine may not have
    monkeypatch.setattr(cuda, "check_cuda_renderer", lambda device: cuda._gsplat())
    device, line = choose_render_device("auto", gpu)
    assert device == torch.device("cpu")
    assert line is not None
    assert "gsplat" in line
    with pytest.raises(UserError, match="gsplat"):
        choose_render_device("cuda", gpu)
    assert choose_render_device("cpu", torch.device("cpu")) == (torch.device("cpu"), None)
    monkeypatch.setattr(cuda, "check_cuda_renderer", lambda device: None)
    assert choose_render_device("auto", gpu) == (gpu, None)


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a GPU")
def test_devices_that_are_not_here_are_named():
    assert choose_device("auto") == torch.device("cpu")
    with pytest.raises(UserError, match="finds no CUDA device"):
        choose_device("cuda")
    for name in ("tpu", "meta", "gpu0", ""):
        with pytest.raises(UserError, match="--device"):
            choose_device(name)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_parity_of_the_real_kernels():
    """Colour, depth and alpha within 1e-4, gradients within 1e-3 relative."""
    from recipes.benchmarks.mvdream_gpu import renderer_parity

    errors = renderer_parity(random_splats(500, 1, 3))
    assert max(errors.color, errors.depth, errors.alpha) < 1e-4
    assert max(errors.gradient_relative.values()) < 1e-3


def test_gradients_of_centers_reach_the_tensors_that_offsets_are_made_of():
    centers = torch.zeros(2, 5, 2, requires_grad=True)
    moved = centers * 1.0
    own = torch.zeros(2, 3, 2, requires_grad=True)
    cuda._pass_center_gradients(moved, torch.cat([torch.zeros(2, 2, 2), own], dim=1), first=0)
    weights = torch.arange(20.0).reshape(2, 5, 2)
    (moved * weights).sum().backward()
    assert torch.equal(own.grad, weights[:, 2:])
