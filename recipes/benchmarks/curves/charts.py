"""Small line charts with linear or logarithmic axes, drawn with Pillow."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from PIL import Image, ImageDraw, ImageFont

_COLORS = (
    "#1f5fa8", "#c8401c", "#2a8a4a", "#8a4ab0", "#a07800", "#108a98", "#d0508a", "#606060",
    "#7a4a20",
)  # fmt: skip
_INK, _GRID = "#202020", "#dcdcdc"
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 150, 34, 46
_STEPS = (1.0, 2.0, 5.0)


@dataclass(frozen=True, slots=True)
class Chart:
    """One panel: named curves over two axes."""

    title: str
    x_label: str
    y_label: str
    curves: Mapping[str, Sequence[tuple[float, float]]]
    """Points of every curve, in the order in which they are joined."""
    log_x: bool = True
    log_y: bool = True
    limits: Mapping[str, float] = field(default_factory=dict)
    """Horizontal dashed lines by name."""
    note_points: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Words beside the points of a curve, by its name; those that would overlap are left out."""


def draw_charts(
    charts: Sequence[Chart], columns: int, size: tuple[int, int] = (580, 340)
) -> Image.Image:
    """Draw panels row by row.

    Args:
        charts: the panels.
        columns: panels in a row.
        size: width and height of a panel in pixels.
    """
    rows = math.ceil(len(charts) / columns)
    sheet = Image.new("RGB", (columns * size[0], rows * size[1]), "white")
    for number, chart in enumerate(charts):
        place = ((number % columns) * size[0], (number // columns) * size[1])
        sheet.paste(_draw_chart(chart, size), place)
    return sheet


class _Axis:
    """Positions of numbers along one axis."""

    def __init__(self, values: Sequence[float], log: bool, start: float, stop: float) -> None:
        self.log, self.start, self.stop = log, start, stop
        values = [v for v in values if math.isfinite(v) and (v > 0 or not log)] or [1.0]
        low, high = self._flat(min(values)), self._flat(max(values))
        pad = 0.06 * (high - low) or (0.3 if log else 0.5 * abs(high) or 0.5)
        self.low, self.high = low - pad, high + pad

    def _flat(self, value: float) -> float:
        return math.log10(max(value, 1e-300)) if self.log else value

    def place(self, value: float) -> float:
        share = (self._flat(value) - self.low) / (self.high - self.low)
        return self.start + share * (self.stop - self.start)

    def ticks(self) -> list[float]:
        if not self.log:
            return _even_ticks(self.low, self.high)
        decades = range(math.floor(self.low), math.ceil(self.high) + 1)
        wide = self.high - self.low > 2.5
        marks = [10.0**d * s for d in decades for s in ((1.0,) if wide else _STEPS)]
        every = max(1, round((self.high - self.low) / 7)) if wide else 1
        marks = [m for m in marks[::every] if self.low <= math.log10(m) <= self.high]
        return marks if len(marks) > 1 else _even_ticks(10**self.low, 10**self.high)


def _even_ticks(low: float, high: float) -> list[float]:
    """Return round numbers at equal distances."""
    step = 10 ** math.floor(math.log10((high - low) / 3))
    step *= max(s for s in _STEPS if 3 * s * step <= high - low)
    return [step * k for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _short(value: float) -> str:
    """Write a tick's number in few characters."""
    for factor, unit in ((1e6, "M"), (1e3, "k")):
        if abs(value) >= factor:
            return f"{value / factor:g}{unit}"
    if 0 < abs(value) < 1e-2:
        return f"{value:.1e}".replace("e-0", "e-").replace(".0e", "e")
    return f"{value:.3g}"


def _draw_chart(chart: Chart, size: tuple[int, int]) -> Image.Image:
    """Draw one panel."""
    picture = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(picture)
    font, bold = ImageFont.load_default(11), ImageFont.load_default(13)
    points = [point for curve in chart.curves.values() for point in curve]
    levels = [y for _, y in points] + list(chart.limits.values())
    x_axis = _Axis([x for x, _ in points], chart.log_x, _LEFT, size[0] - _RIGHT)
    y_axis = _Axis(levels, chart.log_y, size[1] - _BOTTOM, _TOP)
    for tick in x_axis.ticks():
        x = x_axis.place(tick)
        draw.line([(x, _TOP), (x, size[1] - _BOTTOM)], _GRID)
        draw.text((x, size[1] - _BOTTOM + 4), _short(tick), _INK, font, anchor="ma")
    for tick in y_axis.ticks():
        y = y_axis.place(tick)
        draw.line([(_LEFT, y), (size[0] - _RIGHT, y)], _GRID)
        draw.text((_LEFT - 5, y), _short(tick), _INK, font, anchor="rm")
    draw.rectangle([_LEFT, _TOP, size[0] - _RIGHT, size[1] - _BOTTOM], outline=_INK)
    draw.text((_LEFT, 4), chart.title, _INK, bold)
    draw.text((8, _TOP - 13), chart.y_label, _INK, font)
    draw.text((size[0] / 2, size[1] - 18), chart.x_label, _INK, font, anchor="ma")
    for name, level in chart.limits.items():
        y = y_axis.place(level)
        for x in range(_LEFT, size[0] - _RIGHT, 9):
            draw.line([(x, y), (x + 5, y)], _INK)
        draw.text((size[0] - _RIGHT - 4, y - 2), name, _INK, font, anchor="rb")
    taken: list[tuple[float, float]] = []
    for number, (name, curve) in enumerate(chart.curves.items()):
        color = _COLORS[number % len(_COLORS)]
        at = [(x_axis.place(x), y_axis.place(y)) for x, y in curve]
        draw.line(at, color, 2)
        for (x, y), word in zip(at, chart.note_points.get(name, [""] * len(at)), strict=True):
            draw.ellipse([x - 3, y - 3, x + 3, y + 3], fill=color)
            if all(abs(x - u) > 34 or abs(y - v) > 11 for u, v in taken):
                draw.text((x, y - 5), word, color, font, anchor="mb")
                taken.append((x, y))
        draw.text((size[0] - _RIGHT + 8, _TOP + 16 * number), name, color, font)
    return picture
