import dataclasses
import urllib.request

import numpy as np
import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.viewer.layers import Layer, Scene
from gscomplete.viewer.server import (
    TINTS,
    camera_fov,
    covariances,
    layer_colors,
    listen,
    look_from,
    serve,
    show_layer,
)
from gscomplete.views import ViewDistribution
from tests.builders.commands import PATIENCE_S
from tests.builders.objects import random_splats, round_splats


class Page:
    """What a page's camera is told."""

    def __init__(self):
        self.camera = type("Camera", (), {})()


def test_the_page_is_served(viewer):
    address = f"http://127.0.0.1:{viewer.server.get_port()}"
    with urllib.request.urlopen(address, timeout=PATIENCE_S) as page:
        assert page.status == 200
        assert b"<html" in page.read().lower()


@pytest.mark.parametrize("host", ["192.0.2.1", "no.such.host.invalid", "a" * 100])
def test_a_host_that_is_not_this_machine_is_refused_at_once(host):
    pytest.importorskip("viser")
    with pytest.raises(UserError, match=f"--host {host}: expected a name or an address of this"):
        listen(host, 18090)


def test_boxes_hide_layers_and_the_list_colours_them(viewer):
    drawn, boxes = viewer.drawn, viewer.boxes
    assert set(drawn) == set(boxes) == {"P", "new", "--mirror=none", "c", "V"}
    assert drawn["new"].visible
    boxes["new"].value = False
    assert not drawn["new"].visible
    assert drawn["P"].visible
    own = drawn["P"].rgbs.copy()
    viewer.coloring.value = "tints"
    assert not np.array_equal(drawn["P"].rgbs, own)
    viewer.coloring.value = "own"
    assert np.array_equal(drawn["P"].rgbs, own)
    assert not drawn["c"].visible
    boxes["c"].value = True
    assert drawn["c"].visible


def test_one_completion_is_shown_at_a_time(viewer):
    shown = {name: viewer.drawn[name].visible for name in ("P", "new", "--mirror=none")}
    assert shown == {"P": True, "new": True, "--mirror=none": False}
    viewer.choice[0].value = "--mirror=none"
    shown = {name: viewer.drawn[name].visible for name in ("P", "new", "--mirror=none")}
    assert shown == {"P": True, "new": False, "--mirror=none": True}


def test_a_layer_takes_the_place_of_the_one_before(viewer):
    viewer.boxes["new"].value = False
    show_layer(viewer, Layer("new", random_splats(7, seed=5), ""))
    assert len(viewer.drawn["new"].centers) == 7
    assert not viewer.drawn["new"].visible
    viewer.boxes["new"].value = True
    assert viewer.drawn["new"].visible
    viewer.coloring.value = "tints"
    assert len(viewer.drawn["new"].rgbs) == 7


def test_errors_are_of_the_completion_that_is_shown(viewer):
    """Before c, and so before P, or behind P where it changes next to nothing."""
    show_layer(viewer, Layer("P", round_splats(torch.zeros(1, 3), scale=0.1), ""))
    ((_, (at_c,)), (_, at_bounds)) = viewer.frusta
    assert len(at_bounds) == 8
    toward_c = viewer.frusta[0][0].positions / 6
    white = torch.ones(1, 3)
    reds = []
    for place in (toward_c, -toward_c):
        show_layer(viewer, Layer("new", round_splats(place, scale=0.05, color=white), ""))
        picture = at_c.image.astype(int)
        reds.append((picture[..., 0] - picture[..., 1]).max())
    assert reds[0] > 60 > 30 > reds[1]
    before = at_c.image
    viewer.choice[0].value = "--mirror=none"
    assert not np.array_equal(at_c.image, before)


def test_covariances_are_the_splats_second_moments():
    splats = random_splats(20)
    axes = rotation_matrices(splats.quaternions.double())
    expected = axes @ torch.diag_embed(splats.scales.double() ** 2) @ axes.transpose(1, 2)
    assert np.allclose(covariances(splats), expected.numpy(), rtol=1e-5, atol=1e-7)


def test_tints_keep_the_order_of_lightness_and_tell_layers_apart():
    grey = torch.linspace(0.1, 0.9, 5)[:, None].expand(5, 3).contiguous()
    splats = round_splats(torch.zeros(5, 3), color=grey)
    assert np.allclose(layer_colors(splats, "own", 0), grey.numpy(), atol=1e-5)
    errors = layer_colors(splats, "errors", 0, torch.tensor([0.0, 0.0, 1.0, 0.0, 0.0]))
    assert np.allclose(errors[[0, 1, 3, 4]], grey[[0, 1, 3, 4]].numpy(), atol=1e-5)
    assert errors[2].tolist() == pytest.approx([0.8, 0.05, 0.05])
    tinted = [layer_colors(splats, "tints", place) for place in range(len(TINTS))]
    for colors in tinted:
        assert (np.diff(colors.mean(axis=1)) > 0).all()
        assert colors.min() >= 0
        assert colors.max() <= 1
    assert len({colors[2].round(2).tobytes() for colors in tinted}) == len(TINTS)


def test_pages_look_from_a_camera_at_the_object():
    camera = ViewDistribution(90.0, 0.0, radius=2.0, fov_deg=40.0).input_camera(64)
    page = Page()
    look_from(page, camera)
    assert page.camera.position == pytest.approx((0.0, 2.0, 0.0), abs=1e-6)
    assert np.rad2deg(camera_fov(camera)) == pytest.approx(40.0, abs=1e-3)


def test_without_viser_the_user_is_told_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "viser", None)
    with pytest.raises(UserError, match=r"pip install"):
        serve(Scene((), None), "127.0.0.1", 18080)


def test_no_layer_lies_below_another_one():
    pytest.importorskip("viser")
    layers = (Layer("mug", random_splats(3), ""), Layer("mug/partial", random_splats(3), ""))
    started = serve(Scene(layers, None), "127.0.0.1", 18081)
    try:
        first, second = (started.drawn[layer.name].name for layer in layers)
        assert not second.startswith(first + "/")
    finally:
        started.server.stop()


def test_fine_splats_keep_their_shape_in_half_precision(viewer):
    from gscomplete.viewer.server import _MAGNIFIED

    fine = random_splats(50)
    fine = dataclasses.replace(fine, scales=torch.tensor([[2e-3, 1e-3, 2e-4]]).expand(50, 3))
    sent = (_MAGNIFIED**2 * covariances(fine)).astype(np.float16).astype(np.float64)
    found = np.sqrt(np.linalg.eigvalsh(sent).clip(0))[:, ::-1] / _MAGNIFIED
    # 11 bits of the largest variance, of which the second is a quarter, and a root halves that
    assert np.allclose(found[:, :2], [2e-3, 1e-3], rtol=4 * 2**-11 / 2, atol=0)
    assert viewer.drawn["P"].scale == pytest.approx(1 / _MAGNIFIED)
