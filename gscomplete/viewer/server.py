"""Layers of splats on a viser server: a web page that works over SSH.

Conventions
-----------
* The page shows the object frame: z up, cameras in OpenCV axes, as viser's are.
* viser draws splats of one colour from all sides: base colours, no spherical harmonics.
* In tints, every layer has a hue of its own and keeps its lightness.
"""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from gscomplete.errors import UserError
from gscomplete.splats import Splats
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.splats.transform import quaternion_from_rotation
from gscomplete.viewer.layers import Layer, Scene
from gscomplete.viewer.pages import mended_answers
from gscomplete.views import Cameras, ViewDistribution

if TYPE_CHECKING:
    import viser

FloatArray = NDArray[np.float32]
Colors = Literal["own", "tints"]
COLORS: tuple[Colors, ...] = ("own", "tints")
TINTS = ((0.25, 0.5, 0.95), (0.98, 0.55, 0.15), (0.3, 0.75, 0.35), (0.85, 0.3, 0.6))
"""Of the layers in turn: blue, orange, green, pink."""
_TINT_SHARE = 0.6
_FRUSTUM_SCALE = 0.08
_PICTURE_PX = 512
_MAGNIFIED = 32.0
"""viser keeps covariances in half precision, which ends above those of fine splats of an object of
size 1; so the page gets everything this much larger, in a node that is this much smaller."""
_LARGEST_HALF = 65504.0


@dataclass(frozen=True, slots=True)
class Viewer:
    """A running server, what it draws, and the page's controls."""

    server: viser.ViserServer
    drawn: dict[str, Any]
    """Scene nodes by layer; ``c`` is the camera of the input view."""
    boxes: dict[str, Any]
    """What shows and hides each of them."""
    coloring: Any
    """The list of ways to colour layers."""


def serve(scene: Scene, host: str, port: int) -> Viewer:
    """Start a server that shows a scene.

    Args:
        scene: what to show.
        host: address to listen at.
        port: port to listen at; the next free one if it is taken.

    Raises:
        UserError: viser is not installed, or the address cannot be listened at.
    """
    server = _listen(host, port)
    server.scene.set_up_direction("+z")
    coloring = server.gui.add_dropdown("colours", COLORS, initial_value=COLORS[0])
    viewer = Viewer(server, {}, {}, coloring)
    for place, layer in enumerate(scene.layers):
        _add_layer(viewer, layer, place)
    start = _start_camera(scene.views)
    if scene.views is not None:
        _add_view(viewer, scene.views)

    @server.on_client_connect
    def _(client: Any) -> None:
        look_from(client, start)

    return viewer


def look_from(client: Any, camera: Cameras) -> None:
    """Move a page's camera to the place of one of ours, which looks at the origin."""
    client.camera.position = tuple(camera.positions[0].tolist())
    client.camera.look_at = (0.0, 0.0, 0.0)
    client.camera.up_direction = (0.0, 0.0, 1.0)
    client.camera.fov = camera_fov(camera)


def camera_fov(camera: Cameras) -> float:
    """Return the vertical field of view in radians."""
    return float(2.0 * torch.atan(0.5 * camera.height / camera.focal_px[0, 1]))


def layer_colors(splats: Splats, colors: Colors, place: int) -> FloatArray:  # [N, 3]
    """Return the colours of layer number ``place``, in [0, 1]."""
    own = splats.base_colors.detach().float().clamp(0, 1).cpu().numpy()
    if colors == "own":
        return own
    lightness = own.mean(axis=1, keepdims=True)
    hue = np.array(TINTS[place % len(TINTS)], np.float32)
    tinted = hue * (0.35 + 0.65 * lightness)
    return np.float32((1 - _TINT_SHARE) * lightness + _TINT_SHARE * tinted).clip(0, 1)


def covariances(splats: Splats) -> FloatArray:  # [N, 3, 3]
    """Return the splats' second moments."""
    axes = rotation_matrices(splats.quaternions.double()) * splats.scales.double()[:, None]
    moments = axes @ axes.transpose(1, 2)
    return moments.float().cpu().numpy()


def _listen(host: str, port: int) -> viser.ViserServer:
    try:
        import viser
    except ImportError as error:
        raise UserError(
            'the viewer needs viser, which is not installed: pip install "gscomplete[view]"'
        ) from error
    try:
        # viser prints a banner of its own, whatever ``verbose`` says.
        with redirect_stdout(io.StringIO()), mended_answers(host):
            return viser.ViserServer(host=host, port=port, label="GSComplete", verbose=False)
    except OSError as error:
        raise UserError(f"--host {host} --port {port}: cannot listen there: {error}") from error


def _add_layer(viewer: Viewer, layer: Layer, place: int) -> None:
    """Draw a layer, with a box to show or hide it."""
    splats = layer.splats
    handle = viewer.server.scene.add_gaussian_splats(
        f"/layers/{place}",  # not the name: a node below another one would hide with it
        centers=_MAGNIFIED * splats.means.detach().float().cpu().numpy(),
        covariances=(_MAGNIFIED**2 * covariances(splats)).clip(-_LARGEST_HALF, _LARGEST_HALF),
        rgbs=layer_colors(splats, COLORS[0], place),
        opacities=splats.opacities.detach().float().cpu().numpy()[:, None],
        scale=1.0 / _MAGNIFIED,
    )
    _add_box(viewer, layer.name, handle, hint=layer.note, initial=True)

    @viewer.coloring.on_update
    def _(_event: Any) -> None:
        handle.rgbs = layer_colors(splats, viewer.coloring.value, place)


def _add_view(viewer: Viewer, views: ViewDistribution) -> None:
    """Draw the camera of c, hidden at first, with a button that looks from there."""
    camera = views.input_camera(_PICTURE_PX)
    rotation = camera.camera_from_world[0, :3, :3].double().T.contiguous()
    w, x, y, z = quaternion_from_rotation(rotation).tolist()
    frustum = viewer.server.scene.add_camera_frustum(
        "/c",
        fov=camera_fov(camera),
        aspect=1.0,
        scale=_FRUSTUM_SCALE,
        wxyz=(w, x, y, z),
        position=tuple(camera.positions[0].tolist()),
    )
    _add_box(viewer, "c", frustum, hint="camera of the input view", initial=False)
    button = viewer.server.gui.add_button("look from c")

    @button.on_click
    def _(event: Any) -> None:
        look_from(event.client, camera)


def _add_box(viewer: Viewer, name: str, handle: Any, *, hint: str, initial: bool) -> None:
    box = viewer.server.gui.add_checkbox(name, initial_value=initial, hint=hint)
    handle.visible = initial

    @box.on_update
    def _(_event: Any) -> None:
        handle.visible = box.value

    viewer.drawn[name] = handle
    viewer.boxes[name] = box


def _start_camera(views: ViewDistribution | None) -> Cameras:
    chosen = views or ViewDistribution(30.0, 15.0)
    return chosen.input_camera(_PICTURE_PX)
