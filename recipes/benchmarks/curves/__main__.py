"""One page of curves, time against error: ``python -m recipes.benchmarks.curves --results DIR``.

Reads what the benchmarks left in a folder, each under the name that its panel's command gives it,
and writes ``curves.html`` there: for every panel the chart, its points, and the command. A panel
whose file is missing says so and shows the command alone. ``curves.png`` has all the charts.

Conventions
-----------
* Time is to the right, on a logarithmic axis; up is the number that the label names.
* Means are over the objects that a benchmark measured; their count stands in the title.
"""

from __future__ import annotations

import base64
import dataclasses
import html
import io
import statistics
import sys
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from gscomplete.errors import UserError
from gscomplete.util import jsonio
from gscomplete.util.atomic import atomic_path
from recipes.benchmarks.curves.charts import Chart, draw_charts
from recipes.entry_point import start

_RUN = "python -m recipes."
_COLORS = 128
"""Colours of a chart's picture: lines and words need few, and the page stays small."""


@dataclass(frozen=True)
class Options:
    """Draw the page."""

    results: Path
    """Folder with the benchmarks' results, where ``curves.html`` and ``curves.png`` are written."""


@dataclass(frozen=True)
class Panel:
    """What one benchmark shows."""

    title: str
    file: str
    """Within the folder of results."""
    command: str
    """``DIR`` stands for that folder."""
    read: Callable[[Any], list[Chart]]
    """Turns the file's content into charts."""


def _render(content: Any) -> list[Chart]:
    charts = []
    for scene in dict.fromkeys(row["scene"] for row in content["rows"]):
        curves: dict[str, list[tuple[float, float]]] = defaultdict(list)
        for row in content["rows"]:
            if row["scene"] == scene and row["exact_tile_lists"]:
                point = row["ms"], row["uncut"]["color_mean"]
                curves[f"alpha_min {row['alpha_min']:.1g}"].append(point)
        title = f"{scene}: what cut-offs leave out"
        charts.append(
            Chart(title, "ms, forward and backward", "mean colour error", _sorted(curves))
        )
    return charts


def _completion(content: Any) -> list[Chart]:
    rows = content["rows"]
    found: dict[str, list[dict[str, float]]] = defaultdict(list)
    for ways in rows.values():
        for way, row in ways.items():
            found[way].append(row)
    charts = []
    for key, label in (("silhouette_iou", "silhouette IoU"), ("e_color_v", "E_color over V")):
        curves = {way: [_mean(some, "seconds", key)] for way, some in found.items()}
        log = key != "silhouette_iou"
        charts.append(Chart(f"mean of {len(rows)} objects", "seconds", label, curves, log_y=log))
    return charts


def _distillation(content: Any) -> list[Chart]:
    found: _Groups = defaultdict(lambda: defaultdict(list))
    objects = set()
    for name, row in content["rows"].items():
        prior, way, steps, _, item = name.split("/", 4)
        found[f"{prior}, {way}"][int(steps)].append(row)
        objects.add(item)
    labels = {"silhouette_iou": "silhouette IoU", "hidden_color_psnr_db": "hidden PSNR, dB"}
    return _grouped(f"mean of {len(objects)} objects; points: steps", found, "seconds", labels)


def _meshes(content: Any) -> list[Chart]:
    found: _Groups = defaultdict(lambda: defaultdict(list))
    for row in content["scores"]:
        found[row["mode"]][_rounded(row["splats"])].append(row)
    count = len({row["mesh"] for row in content["scores"]})
    labels = {"iou": "silhouette IoU", "psnr_db": "PSNR, dB"}
    return _grouped(f"mean of {count} meshes; points: splats", found, "convert_s", labels)


def _rounded(count: int) -> int:
    """Return the count that was asked for: a mesh has some more or less, to fit its edges."""
    step = 10 ** max(len(str(round(count * 1.05))) - 1, 0)
    return round(count / step) * step


_Groups = dict[str, dict[int, list[dict[str, float]]]]
"""Rows by curve, and within it by the number that grows along it."""


def _grouped(title: str, found: _Groups, time_key: str, labels: Mapping[str, str]) -> list[Chart]:
    """Draw a chart for each of some numbers: a point is the mean of a group."""
    words = {name: [f"{number:,}" for number in sorted(of)] for name, of in found.items()}
    charts = []
    for key, label in labels.items():
        curves = {
            name: [_mean(some, time_key, key) for _, some in sorted(groups.items())]
            for name, groups in found.items()
        }
        charts.append(Chart(title, "seconds", label, curves, log_y=False, note_points=words))
    return charts


def _captures(content: Any) -> list[Chart]:
    curves: dict[str, list[tuple[float, float]]] = defaultdict(list)
    words: dict[str, list[str]] = defaultdict(list)
    for row in sorted(content, key=lambda row: (row["capture"], row["steps"])):
        curves[row["capture"]].append((row["seconds"], row["held_out_psnr_db"]))
        words[row["capture"]].append(f"{row['steps']:,}")
    label = "PSNR of held-out photos, dB"
    title = "from photos and poses to splats; points: steps"
    return [Chart(title, "seconds", label, curves, log_y=False, note_points=words)]


def _mean(rows: list[dict[str, float]], x_key: str, y_key: str) -> tuple[float, float]:
    """Return the means of two numbers, each over the rows that have it."""
    x, y = ([row[key] for row in rows if row[key] is not None] for key in (x_key, y_key))
    return statistics.fmean(x), statistics.fmean(y)


def _sorted(
    curves: Mapping[str, list[tuple[float, float]]],
) -> dict[str, list[tuple[float, float]]]:
    return {name: sorted(points) for name, points in curves.items()}


PANELS = (
    Panel(
        "Render",
        "renderer_accuracy.json",
        f"{_RUN}benchmarks.renderer.accuracy --mesh ../shared/data/mesh/armadillo.obj --out DIR",
        _render,
    ),
    Panel("Completion", "completion.json", f"{_RUN}benchmarks.completion --out DIR", _completion),
    Panel(
        "Distillation",
        "known_priors/results.json",
        f"{_RUN}known_priors --meshes PACK --out DIR/known_priors --objects 3 --resolution-px 128 "
        "--steps 50 100 200 400 --priors plausible mvdream-like --ways paper latent",
        _distillation,
    ),
    Panel(
        "Mesh conversion",
        "mesh_conversion.json",
        f"{_RUN}benchmarks.mesh_conversion --curve 10000 30000 300000 "
        "--json DIR/mesh_conversion.json",
        _meshes,
    ),
    Panel(
        "Captures",
        "captures.json",
        "for steps in 250 500 1000 3000; do "
        f"{_RUN}benchmarks.multiview --steps $steps --json DIR/captures.json; done",
        _captures,
    ),
)


def charts_of(panel: Panel, folder: Path) -> list[Chart] | None:
    """Return a panel's charts; None = it was not measured.

    Raises:
        UserError: its file is not what its benchmark writes.
    """
    path = folder / panel.file
    if not path.is_file():
        return None
    try:
        return panel.read(jsonio.read_json(path))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UserError(f"{path}: expected what this writes: {panel.command}") from error


def page(folder: Path) -> str:
    """Return the page of a folder of results.

    Raises:
        UserError: a file is not what its benchmark writes.
    """
    parts = [_HEAD]
    for panel in PANELS:
        parts.append(f"<h2>{panel.title}</h2>\n<pre>{html.escape(panel.command)}</pre>\n")
        charts = charts_of(panel, folder)
        if charts is None:
            parts.append(f"<p>Not measured: there is no {html.escape(panel.file)}.</p>\n")
        for chart in charts or ():
            parts.append(_figure(chart))
    return "".join(parts)


def picture(folder: Path) -> Image.Image | None:
    """Return all charts of a folder of results side by side; None = nothing was measured.

    Raises:
        UserError: a file is not what its benchmark writes.
    """
    charts = [
        dataclasses.replace(chart, title=f"{panel.title}: {chart.title}")
        for panel in PANELS
        for chart in charts_of(panel, folder) or ()
    ]
    return draw_charts(charts, 2).quantize(_COLORS) if charts else None


def _figure(chart: Chart) -> str:
    """Return a chart with its points as a table that can be folded out."""
    sheet = draw_charts([chart], 1).quantize(_COLORS)
    packed = io.BytesIO()
    sheet.save(packed, "PNG", optimize=True)
    data = base64.b64encode(packed.getvalue()).decode()
    label = html.escape(f"{chart.y_label} over {chart.x_label}: {chart.title}")
    rows = "".join(
        f"<tr><td>{html.escape(name)}<td>{x:.4g}<td>{y:.4g}"
        for name, points in chart.curves.items()
        for x, y in points
    )
    return (
        f'<figure><img alt="{label}" src="data:image/png;base64,{data}">'
        f"<details><summary>points</summary><table><tr><th><th>{html.escape(chart.x_label)}"
        f"<th>{html.escape(chart.y_label)}{rows}</table></details></figure>\n"
    )


_HEAD = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Time against error</title>
<style>
body { font: 15px system-ui, sans-serif; margin: 2em; max-width: 1200px }
pre { background: #f3f3f3; padding: .6em; white-space: pre-wrap }
figure { display: inline-block; margin: 0 1em 1em 0; vertical-align: top }
td, th { padding: 0 .8em 0 0; text-align: left }
</style>
<h1>Time against error</h1>
"""


def main(options: Options) -> None:
    """Write the page."""
    text = page(options.results)
    with atomic_path(options.results / "curves.html") as temporary:
        temporary.write_text(text, encoding="utf-8")
    sheet = picture(options.results)
    if sheet is not None:
        with atomic_path(options.results / "curves.png") as temporary:
            sheet.save(temporary, "PNG", optimize=True)
    sys.stdout.write(f"written: {options.results / 'curves.html'}, {len(text) / 1e3:.0f} kB\n")


if __name__ == "__main__":
    start(main, Options, __doc__)
