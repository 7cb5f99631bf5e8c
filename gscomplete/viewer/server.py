"""Show layers of splats with a viser server: a web page that also works over SSH.

Conventions
-----------
* The page shows the object frame: z up, cameras in OpenCV axes, as viser's are.
* viser draws a splat in the same colour from all directions: base colours, no spherical harmonics.
* With tints, every layer gets a hue of its own and keeps its lightness. With errors, P is grey, and
  red where the shown completion changes its appearance from c or from the bounds of V. The frusta
  of these cameras show the same errors as pictures.
"""

from __future__ import annotations

import io
import socket
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch
from torch import Tensor

from gscomplete.errors import UserError
from gscomplete.evaluate.pictures import ERROR_INK
from gscomplete.splats import Splats
from gscomplete.splats.rotations import rotation_matrices
from gscomplete.splats.transform import quaternion_from_rotation
from gscomplete.util.arrays import Float32Array
from gscomplete.viewer.layers import Layer, Scene
from gscomplete.viewer.pages import mended_answers
from gscomplete.viewer.view_errors import bounds_of, view_errors
from gscomplete.views import Cameras, ViewDistribution, join_cameras

if TYPE_CHECKING:
    import viser

Colors = Literal["own", "tints", "errors"]
COLORS: tuple[Colors, ...] = ("own", "tints", "errors")
TINTS = ((0.25, 0.5, 0.95), (0.98, 0.55, 0.15), (0.3, 0.75, 0.35), (0.85, 0.3, 0.6))
"""Of the layers in turn: blue, orange, green, pink."""
_TINT_SHARE = 0.6
_FRUSTUM_SCALE = 0.08
_FRUSTUM_LINE_PX = 1.5
_PICTURE_PX = 512
_ERROR_PX = 160
_MAGNIFIED = 32.0
"""viser keeps covariances in half precision, which ends above those of fine splats of an object of
size 1; so the page gets everything this much larger, in a node that is this much smaller."""
_LARGEST_HALF = 65504.0


@dataclass(frozen=True, slots=True)
class Viewer:
    """A running server, what it draws, and the page's controls."""

    server: viser.ViserServer
    drawn: dict[str, Any]
    """Scene nodes by layer; ``c`` is the camera of the input view, ``V`` those of its bounds."""
    boxes: dict[str, Any]
    """What shows and hides each of them."""
    coloring: Any
    """The list of ways to colour layers."""
    colored: dict[str, tuple[Layer, int]]
    """What is drawn, by layer, and its number."""
    status: Any
    """A line of text."""
    choice: list[Any]
    """The list of completions to choose from, if there are several."""
    frusta: list[tuple[Cameras, list[Any]]]
    """Cameras of c and of V, and the node of each."""
    errors: list[Tensor]
    """On P's splats, if there are views and a completion."""


def serve(scene: Scene, host: str, port: int) -> Viewer:
    """Start a server that shows a scene.

    Args:
        scene: what to show.
        host: address to listen at.
        port: port to listen at; the next free one if it is taken.

    Raises:
        UserError: viser is not installed, or the address cannot be listened at.
    """
    server = listen(host, port)
    server.scene.set_up_direction("+z")
    coloring = server.gui.add_dropdown("colours", COLORS, initial_value=COLORS[0])
    status = server.gui.add_markdown("the run goes on" if scene.running else "")
    viewer = Viewer(server, {}, {}, coloring, {}, status, [], [], [])
    for place, layer in enumerate(scene.layers):
        _add_layer(viewer, layer, place)
    add_choice(viewer)
    start = _start_camera(scene.views)
    if scene.views is not None:
        _add_views(viewer, scene.views)

    @coloring.on_update
    def _(_event: Any) -> None:
        for name in viewer.colored:
            viewer.drawn[name].rgbs = _colors(viewer, name)

    @server.on_client_connect
    def _(client: Any) -> None:
        look_from(client, start)

    return viewer


def look_from(client: Any, camera: Cameras) -> None:
    """Move a page's camera to the position of a given camera that looks at the origin."""
    client.camera.position = tuple(camera.positions[0].tolist())
    client.camera.look_at = (0.0, 0.0, 0.0)
    client.camera.up_direction = (0.0, 0.0, 1.0)
    client.camera.fov = camera_fov(camera)


def camera_fov(camera: Cameras) -> float:
    """Return the vertical field of view in radians."""
    return float(2.0 * torch.atan(0.5 * camera.height / camera.focal_px[0, 1]))


def layer_colors(
    splats: Splats,
    colors: Colors,
    place: int,
    errors: Tensor | None = None,  # [N] on its splats; None = there are none
) -> Float32Array:  # [N, 3]
    """Return the colours of layer number ``place``, in [0, 1]."""
    own = splats.base_colors.detach().float().clamp(0, 1).cpu().numpy()
    if colors == "own":
        return own
    lightness = own.mean(axis=1, keepdims=True)
    if colors == "errors":
        red = np.zeros_like(lightness) if errors is None else errors.float().numpy()[:, None]
        return np.float32((1 - red) * lightness + red * np.array(ERROR_INK)).clip(0, 1)
    hue = np.array(TINTS[place % len(TINTS)], np.float32)
    tinted = hue * (0.35 + 0.65 * lightness)
    return np.float32((1 - _TINT_SHARE) * lightness + _TINT_SHARE * tinted).clip(0, 1)


def covariances(splats: Splats) -> Float32Array:  # [N, 3, 3]
    """Return the splats' second moments."""
    axes = rotation_matrices(splats.quaternions.double()) * splats.scales.double()[:, None]
    moments = axes @ axes.transpose(1, 2)
    return moments.float().cpu().numpy()


def listen(host: str, port: int) -> viser.ViserServer:
    """Start an empty server.

    Args:
        host: address to listen at.
        port: port to listen at; the next free one if it is taken.

    Raises:
        UserError: viser is not installed, or the address cannot be listened at.
    """
    try:
        import viser
    except ImportError as error:
        raise UserError(
            'the viewer needs viser, which is not installed: pip install "gscomplete[view]"'
        ) from error
    _require_own_address(host)
    try:
        # viser prints a banner of its own, whatever ``verbose`` says.
        with redirect_stdout(io.StringIO()), mended_answers(host):
            return viser.ViserServer(host=host, port=port, label="GSComplete", verbose=False)
    except OSError as error:
        raise UserError(f"--host {host} --port {port}: cannot listen there: {error}") from error


def _require_own_address(host: str) -> None:
    """Refuse a host that is not this machine's: viser would wait for it without end.

    Raises:
        UserError: nothing can listen there.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(address)
    except (OSError, UnicodeError) as error:
        raise UserError(
            f"--host {host}: expected a name or an address of this machine, to listen at ({error})"
        ) from error


def show_layer(viewer: Viewer, layer: Layer) -> None:
    """Draw a layer, new or replacing the one of the same name, and update the errors."""
    if layer.name == "P":
        viewer.errors.clear()
    if layer.name in viewer.drawn:
        place = viewer.colored[layer.name][1]
        handle = _drawn(viewer, layer, place)
        handle.visible = viewer.boxes[layer.name].value
        viewer.drawn[layer.name] = handle
    else:
        _add_layer(viewer, layer, len(viewer.colored))
    if layer.name in ("P", "new"):
        show_errors(viewer)


def _add_layer(viewer: Viewer, layer: Layer, place: int) -> None:
    """Draw a layer, with a check box that shows or hides it."""
    handle = _drawn(viewer, layer, place)
    _add_box(viewer, layer.name, handle, hint=layer.note, initial=not layer.is_alternative)


def _drawn(viewer: Viewer, layer: Layer, place: int) -> Any:
    """Draw a layer under its number, replacing what was drawn under that number."""
    splats = layer.splats
    viewer.colored[layer.name] = (layer, place)
    return viewer.server.scene.add_gaussian_splats(
        f"/layers/{place}",  # not the name: a node below another one would hide with it
        centers=_MAGNIFIED * splats.means.detach().float().cpu().numpy(),
        covariances=(_MAGNIFIED**2 * covariances(splats)).clip(-_LARGEST_HALF, _LARGEST_HALF),
        rgbs=_colors(viewer, layer.name),
        opacities=splats.opacities.detach().float().cpu().numpy()[:, None],
        scale=1.0 / _MAGNIFIED,
    )


def add_choice(viewer: Viewer) -> None:
    """Let the page show one completion at a time: the result, or an alternative."""
    names = [name for name, (layer, _) in viewer.colored.items() if layer.is_alternative]
    if viewer.choice or not names or "new" not in viewer.boxes:
        return
    choice = viewer.server.gui.add_dropdown("completion", ("new", *names), initial_value="new")
    viewer.choice.append(choice)

    @choice.on_update
    def _(_event: Any) -> None:
        for name in ("new", *names):
            viewer.boxes[name].value = name == choice.value
        show_errors(viewer)


def show_errors(viewer: Viewer) -> None:
    """Draw on P, and into the frusta, how far the shown completion changes P's appearance."""
    chosen = viewer.choice[0].value if viewer.choice else "new"
    viewer.errors.clear()
    if not viewer.frusta or not {"P", chosen} <= set(viewer.colored):
        return
    partial, added = (viewer.colored[name][0].splats for name in ("P", chosen))
    cameras = join_cameras([cameras for cameras, _ in viewer.frusta])
    found = view_errors(partial, added, cameras)
    handles = [handle for _, group in viewer.frusta for handle in group]
    for handle, picture in zip(handles, found.pictures, strict=True):
        handle.image = picture
    viewer.errors.append(found.on_splats)
    viewer.drawn["P"].rgbs = _colors(viewer, "P")


def _colors(viewer: Viewer, name: str) -> Float32Array:  # [N, 3]
    layer, place = viewer.colored[name]
    errors = viewer.errors[0] if name == "P" and viewer.errors else None
    return layer_colors(layer.splats, viewer.coloring.value, place, errors)


def _add_views(viewer: Viewer, views: ViewDistribution) -> None:
    """Draw the cameras of c and of V's bounds, hidden at first, with a button that looks from c."""
    camera = views.input_camera(_PICTURE_PX)
    for name, cameras, hint in (
        ("c", views.input_camera(_ERROR_PX), "camera of the input view, errors on P in red"),
        ("V", bounds_of(views, _ERROR_PX), "cameras at the bounds of V, errors on P in red"),
    ):
        node = viewer.server.scene.add_frame(f"/{name}", show_axes=False)
        handles = []
        for index in range(len(cameras)):
            rotation = cameras.camera_from_world[index, :3, :3].double().T.contiguous()
            w, x, y, z = quaternion_from_rotation(rotation).tolist()
            frustum = viewer.server.scene.add_camera_frustum(
                f"/{name}/{index}",
                fov=camera_fov(cameras),
                aspect=1.0,
                scale=_FRUSTUM_SCALE,
                thickness=_FRUSTUM_LINE_PX,
                thickness_units="screen",
                wxyz=(w, x, y, z),
                position=tuple(cameras.positions[index].tolist()),
            )
            handles.append(frustum)
        viewer.frusta.append((cameras, handles))
        _add_box(viewer, name, node, hint=hint, initial=False)
    show_errors(viewer)
    button = viewer.server.gui.add_button("look from c")

    @button.on_click
    def _(event: Any) -> None:
        look_from(event.client, camera)


def _add_box(viewer: Viewer, name: str, handle: Any, *, hint: str, initial: bool) -> None:
    box = viewer.server.gui.add_checkbox(name, initial_value=initial, hint=hint)
    handle.visible = initial

    @box.on_update
    def _(_event: Any) -> None:
        viewer.drawn[name].visible = box.value

    viewer.drawn[name] = handle
    viewer.boxes[name] = box


def _start_camera(views: ViewDistribution | None) -> Cameras:
    chosen = views or ViewDistribution(30.0, 15.0)
    return chosen.input_camera(_PICTURE_PX)
