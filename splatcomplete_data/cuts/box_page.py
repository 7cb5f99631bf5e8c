"""A page on which boxes are chosen: a gizmo moves and turns a box, and sliders set its size.

Conventions
-----------
* The page shows the file's own frame, in its units, with the given direction up. Browsers draw in
  float32, so an offset is subtracted from large coordinates. Boxes are kept in the file's
  coordinates.
* Points that the boxes keep have their own colours, the others a pale blue. Counts are over all
  points; of many points an even choice is drawn.
* What is saved is text, a box a line, as ``--box`` reads it (``boxes.read_boxes``).
"""

from __future__ import annotations

import dataclasses
import shlex
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gscomplete.errors import UserError
from gscomplete.util.arrays import BoolArray, Float32Array, Float64Array
from gscomplete.util.atomic import atomic_path
from gscomplete.viewer.server import listen
from splatcomplete_data.cuts.boxes import Action, CropBox, box_text, inside_boxes
from splatcomplete_data.points import offset_for_float32

if TYPE_CHECKING:
    import viser


_MOST_DRAWN = 300_000
_EXTENT_QUANTILES = (0.02, 0.98)
"""Of the points along each axis: floaters do not decide how large a box may get."""
_FIRST_SHARE = 0.25
"""Half the side of a new box, of the scene's size."""
_LEAST_SHARE = 0.002
_POINT_SHARE = 0.002
"""Side of a drawn point, of the scene's size."""
_LEFT_OUT = (0.62, 0.70, 0.85)
_LEFT_OUT_SHARE = 0.75
"""How far the colours of what is not kept are drawn towards this pale blue."""
_LINE_COLORS = {"keep": (30, 140, 60), "remove": (200, 40, 40)}
_CHOSEN_PX = 3.0


@dataclass(frozen=True, slots=True)
class PickedPoints:
    """What boxes are chosen in."""

    points: NDArray[np.floating]  # [N, 3] file frame
    colors: Float32Array  # [N, 3] in [0, 1]
    up: tuple[float, float, float]
    """Unit vector, file frame."""


@dataclass(slots=True)
class BoxPage:
    """A running server and the boxes that its page holds."""

    server: viser.ViserServer
    picked: PickedPoints
    boxes: list[CropBox]
    path: Path
    """Where they are saved."""
    command: str
    """Start of the command line that uses the boxes, up to ``--box``."""
    told: Callable[[str], object]
    """Called with that command line when boxes are saved, or with the reason why they are not."""
    offset: Float64Array  # [3]
    """File coordinates less page coordinates."""
    chosen: int = 0
    """Index of the box that the gizmo moves."""
    controls: dict[str, Any] = field(default_factory=dict)
    """The page's controls by label."""
    nodes: dict[str, Any] = field(default_factory=dict)
    """What is drawn, by name."""
    is_following: bool = False
    """Whether controls are being set to a box, and not by a user."""
    lock: threading.RLock = field(default_factory=threading.RLock)
    """Held by whoever changes the page: viser calls back from many threads at once."""

    @property
    def center_and_size(self) -> tuple[Float64Array, float]:
        """Return the middle of the scene and its longest side, floaters aside."""
        low, high = _extent(self.picked)
        return (low + high) / 2, max(float((high - low).max()), 1e-9)

    def kept(self) -> BoolArray:  # [N]
        """Return what the boxes keep."""
        return inside_boxes(self.picked.points, self.boxes)

    def add(self, action: Action) -> None:
        """Add a box in the middle of the scene and choose it."""
        center, size = self.center_and_size
        x, y, z = center.tolist()
        self.boxes.append(CropBox((x, y, z), (_FIRST_SHARE * size,) * 3, action=action))
        self.choose(len(self.boxes) - 1)

    def take_away(self) -> None:
        """Delete the chosen box; the last one stays."""
        if len(self.boxes) > 1:
            del self.boxes[self.chosen]
            self.choose(max(self.chosen - 1, 0))

    def choose(self, index: int) -> None:
        """Let the gizmo and the sliders follow a box."""
        self.chosen = index
        box = self.boxes[index]
        self.is_following = True
        names = [f"{number}: {one.action}" for number, one in enumerate(self.boxes, 1)]
        self.controls["box"].options = names
        self.controls["box"].value = names[index]
        for axis, half in zip("xyz", box.half_extents, strict=True):
            self.controls[axis].value = half
        self.nodes["gizmo"].position = tuple((np.asarray(box.center) - self.offset).tolist())
        self.nodes["gizmo"].wxyz = box.quaternion
        self.is_following = False
        self.draw()

    def change(self, **what: Any) -> None:
        """Change the chosen box."""
        if not self.is_following:
            self.boxes[self.chosen] = dataclasses.replace(self.boxes[self.chosen], **what)
            self.draw_boxes()

    def draw(self) -> None:
        """Draw the boxes, colour the points by what they keep, and tell how many."""
        self.draw_boxes()
        kept = self.kept()
        self.nodes["points"].colors = _colors(self.picked.colors, kept)[:: self._step()]
        self.controls["count"].content = f"keeps {int(kept.sum()):,} of {len(kept):,} points"

    def draw_boxes(self) -> None:
        """Draw the boxes' edges, those of the chosen one thicker."""
        for name in [name for name in self.nodes if name.startswith("/boxes/")]:
            self.nodes.pop(name).remove()
        for index, box in enumerate(self.boxes):
            name = f"/boxes/{index}"
            self.nodes[name] = self.server.scene.add_line_segments(
                name,
                (_edges(box) - self.offset).astype(np.float32),
                colors=_LINE_COLORS[box.action],
                thickness=_CHOSEN_PX if index == self.chosen else 1.0,
                thickness_units="screen",
            )

    def save(self) -> None:
        """Write the boxes, and tell how they are used, or why they could not be written."""
        try:
            with atomic_path(self.path) as path:
                path.write_text("".join(f"{box_text(box)}\n" for box in self.boxes))
        except UserError as error:
            self.controls["saved"].content = f"not saved: {error}"
            self.told(f"not saved: {error}")
            return
        line = f"{self.command} --box {shlex.quote(str(self.path))}"
        self.controls["saved"].content = f"saved; now run `{line}`"
        self.told(line)

    def _step(self) -> int:
        return -(-len(self.picked.points) // _MOST_DRAWN)


def pick_boxes(
    picked: PickedPoints,
    boxes: Sequence[CropBox],
    path: Path,
    command: str,
    told: Callable[[str], object],
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
) -> BoxPage:
    """Start a server whose page edits boxes and saves them.

    Args:
        picked: what to cut.
        boxes: to begin with; none = one about the middle.
        path: where they are saved.
        command: what is typed with the file, up to ``--box``.
        told: called with that line when the boxes are saved, or with why they are not.
        host: address to listen at.
        port: port to listen at; the next free one if it is taken.

    Raises:
        UserError: there are no points, viser is not installed, or the address cannot be listened
            at.
    """
    if not np.isfinite(picked.points).all(axis=1).any():
        raise UserError("--pick: expected points to choose boxes in, found none")
    server = listen(host, port)
    offset = np.array(offset_for_float32(*_extent(picked)) or (0.0, 0.0, 0.0))
    page = BoxPage(server, picked, list(boxes), path, command, told, offset)
    _, size = page.center_and_size
    server.scene.set_up_direction(picked.up)
    step = page._step()
    page.nodes["points"] = server.scene.add_point_cloud(
        "/points",
        (picked.points[::step] - offset).astype(np.float32),
        _colors(picked.colors, np.ones(len(picked.points), np.bool_))[::step],
        point_size=_POINT_SHARE * size,
        precision="float32",
    )
    page.nodes["gizmo"] = server.scene.add_transform_controls(
        "/gizmo", scale=0.3 * size, depth_test=False
    )
    _add_controls(page, size)
    if page.boxes:
        page.choose(0)
    else:
        page.add("keep")

    server.on_client_connect(lambda client: _look_at(client, page))
    return page


def _add_controls(page: BoxPage, size: float) -> None:
    """Add the page's list, sliders and buttons, and let the gizmo move the chosen box."""
    gui, gizmo = page.server.gui, page.nodes["gizmo"]
    largest = max([size, *(half for box in page.boxes for half in box.half_extents)])

    def one_at_a_time(react: Callable[[Any], object]) -> Callable[[Any], None]:
        def locked(event: Any) -> None:
            with page.lock:
                react(event)

        return locked

    def pressed(action: Callable[[], None]) -> Callable[[Any], None]:
        return one_at_a_time(lambda _event: action())

    page.controls["count"] = gui.add_markdown("")
    page.controls["box"] = gui.add_dropdown("box", ["1: keep"])
    for axis in "xyz":
        page.controls[axis] = gui.add_slider(
            axis,
            min=_LEAST_SHARE * size,
            max=largest,
            step=_LEAST_SHARE * size / 4,
            initial_value=_FIRST_SHARE * size,
            hint=f"half the box's side along its own {axis} axis, in the file's units",
        )
    for label, action in (
        ("add a box to keep", lambda: page.add("keep")),
        ("add a box to remove", lambda: page.add("remove")),
        ("delete this box", page.take_away),
        ("save", page.save),
    ):
        page.controls[label] = gui.add_button(label)
        page.controls[label].on_click(pressed(action))
    page.controls["saved"] = gui.add_markdown("")

    def sized(_event: Any) -> None:
        page.change(half_extents=tuple(float(page.controls[axis].value) for axis in "xyz"))
        if not page.is_following:
            page.draw()

    def chosen(_event: Any) -> None:
        if not page.is_following:
            page.choose(int(page.controls["box"].value.split(":")[0]) - 1)

    def moved(event: Any) -> None:
        center = tuple((np.asarray(gizmo.position, np.float64) + page.offset).tolist())
        page.change(center=center, quaternion=tuple(float(v) for v in gizmo.wxyz))
        if event.phase == "end":  # colouring all points is too slow for a drag
            page.draw()

    for axis in "xyz":
        page.controls[axis].on_update(one_at_a_time(sized))
    page.controls["box"].on_update(one_at_a_time(chosen))
    gizmo.on_update(one_at_a_time(moved))


def _look_at(client: Any, page: BoxPage) -> None:
    """Place a page's camera obliquely above the scene."""
    center, size = page.center_and_size
    center = center - page.offset
    up = np.asarray(page.picked.up)
    side = np.cross(up, np.eye(3)[int(np.abs(up).argmin())])
    side /= np.linalg.norm(side)
    client.camera.position = tuple(center + size * (0.9 * side + 0.45 * up))
    client.camera.look_at = tuple(center)
    client.camera.up_direction = tuple(up)


def _colors(colors: Float32Array, kept: BoolArray) -> NDArray[np.uint8]:  # [N, 3]
    """Return the colours of points, pale where they are not kept."""
    pale = (1 - _LEFT_OUT_SHARE) * colors + _LEFT_OUT_SHARE * np.array(_LEFT_OUT)
    shown = np.where(kept[:, None], colors, pale)
    return (255 * shown.clip(0, 1)).round().astype(np.uint8)


def _extent(picked: PickedPoints) -> tuple[Float64Array, Float64Array]:  # [3], [3]
    """Return the corners of the box of the points, floaters aside."""
    points = picked.points[np.isfinite(picked.points).all(axis=1)]
    low, high = np.quantile(points.astype(np.float64), _EXTENT_QUANTILES, axis=0)
    return low, high


def _edges(box: CropBox) -> Float64Array:  # [12, 2, 3] file frame
    """Return the ends of a box's edges."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = signs * np.asarray(box.half_extents) @ box.rotation.T + np.asarray(box.center)
    ends = [
        (a, b) for a in range(8) for b in range(a + 1, 8) if int((signs[a] != signs[b]).sum()) == 1
    ]
    edges: Float64Array = corners[np.array(ends)]
    return edges
