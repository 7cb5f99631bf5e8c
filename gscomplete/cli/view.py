"""``gscomplete view``: look at a run or at splat files in a browser."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gscomplete.errors import UserError


@dataclass(frozen=True)
class ViewOptions:
    """Look at a run or at splat files in a browser.

    For a run, the page has P and the new splats, which can be hidden separately; its alternatives,
    to choose from; and the cameras of c and V, with changes of P's appearance from there in red. A
    run in progress is followed from checkpoint to checkpoint.

    Example: gscomplete view runs/mug. On another machine, forward the port first:
    ssh -L 8080:localhost:8080 MACHINE. Ctrl-C ends it.
    """

    paths: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """A run folder; an object folder; or splat files and folders of them, each file a layer."""
    up: str = "Z"
    """Axis of the files that points up; run and object folders record their own."""
    host: str = "127.0.0.1"
    """Address to listen at; 0.0.0.0 lets other machines connect."""
    port: int = 8080
    """Port to listen at; the next free one if it is taken."""
    most_splats: int = 500_000
    """If a layer has more splats, an even subset is drawn, with splats enlarged to match."""


def run(options: ViewOptions) -> int:
    """Serve the page until interrupted; return the exit code."""
    from gscomplete.viewer.layers import live_layer, read_scene
    from gscomplete.viewer.live import Progress, follow
    from gscomplete.viewer.server import add_choice, serve, show_layer
    from gscomplete.views import parse_up

    if not options.paths:
        raise UserError("view: expected a run folder or splat files, found none")
    if options.most_splats < 1:
        raise UserError(f"--most-splats: expected at least 1, found {options.most_splats}")
    if not 1 <= options.port <= 65535:
        raise UserError(f"--port: expected 1 to 65535, found {options.port}")
    scene = read_scene(options.paths, parse_up(options.up) or "Z", options.most_splats)
    viewer = serve(scene, options.host, options.port)
    server, stop = viewer.server, threading.Event()

    def show(progress: Progress) -> None:
        """Show a step of a run that goes on."""
        show_layer(viewer, live_layer(progress.splats, options.most_splats))
        viewer.status.content = f"run in progress: step {progress.step}"

    def show_result(is_finished: bool) -> None:
        """Show the result of a run, and when it has finished its alternatives."""
        for layer in read_scene(options.paths, "Z", options.most_splats).layers:
            show_layer(viewer, layer)
        add_choice(viewer)
        viewer.status.content = (
            "the run has finished" if is_finished else "the result is made and is being measured"
        )

    if scene.running is not None:
        arguments = (scene.running, show, show_result, stop)
        threading.Thread(target=follow, args=arguments, daemon=True).start()
    try:
        for layer in scene.layers:
            print(f"{layer.name}: {layer.note}")
        print(f"http://{server.get_host()}:{server.get_port()} (Ctrl-C ends it)", flush=True)
        threading.Event().wait()
    except KeyboardInterrupt:
        pass
    finally:
        stop.set()
        server.stop()
    return 0
