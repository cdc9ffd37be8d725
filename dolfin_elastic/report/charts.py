"""Line charts and histograms as inline SVG, whose colours follow the page's scheme.

The page forbids style attributes, and its colours change between light, dark and paper: so lines
carry classes ("line-0" ...), which the style sheet colours.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from dolfin_elastic.core.si_text import number
from dolfin_elastic.core.types import FloatArray

WIDTH, HEIGHT = 420, 280
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 14, 14, 48
_MOST = 400
"""Points of a line; longer ones are thinned out so that their extremes stay."""
_ADVANCE = 6.6
"""Width of a letter of the labels."""


@dataclass(frozen=True)
class Line:
    """A curve.

    Attributes:
        name: For the legend; empty: none.
        x: Shape (n,).
        y: Shape (n,); what is not finite interrupts the line.
    """

    name: str
    x: FloatArray
    y: FloatArray


@dataclass(frozen=True)
class Axis:
    """An axis.

    Attributes:
        label: Its name with unit.
        logarithmic: Powers of ten.
        whole: Integers only.
    """

    label: str
    logarithmic: bool = False
    whole: bool = False


class _Scale:
    """From values to places in the picture."""

    def __init__(self, values: FloatArray, begin: float, end: float, axis: Axis) -> None:
        self.axis, self._begin, self._end = axis, begin, end
        finite = values[np.isfinite(values)]
        if axis.logarithmic:
            finite = finite[finite > 0]
            low, high = (finite.min(), finite.max()) if len(finite) else (0.1, 1.0)
            self.low = float(math.floor(math.log10(low)))
            self.high = float(math.ceil(math.log10(high)))
            self.high += self.high == self.low
            every = max(1, math.ceil((self.high - self.low) / 6))
            self.ticks = [10.0**k for k in range(int(self.low), int(self.high) + 1, every)]
            return
        low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
        if high - low <= 1e-9 * max(abs(low), abs(high)):
            room = abs(high) or 1.0
            low, high = low - room / 2, high + room / 2
        step = _round_step((high - low) / 4)
        step = max(1.0, step) if axis.whole else step
        self.low, self.high = math.floor(low / step) * step, math.ceil(high / step) * step
        count = round((self.high - self.low) / step)
        self.ticks = [self.low + k * step for k in range(count + 1)]
        self.ticks = [0.0 if abs(t) < 1e-9 * step else t for t in self.ticks]

    def __call__(self, value: float) -> float:
        """The place of a value."""
        v = math.log10(max(value, 1e-300)) if self.axis.logarithmic else value
        share = (v - self.low) / (self.high - self.low)
        return self._begin + share * (self._end - self._begin)

    def text(self, tick: float) -> str:
        """The label of a tick."""
        if self.axis.logarithmic:
            return f"1e{round(math.log10(tick))}".replace("-", "−")
        return number(tick)


def _round_step(size: float) -> float:
    power = 10.0 ** math.floor(math.log10(size))
    return next(k * power for k in (1, 2, 2.5, 5, 10) if k * power >= 0.999 * size)


def line_chart(lines: Sequence[Line], x: Axis, y: Axis, title: str = "") -> Markup:
    """Curves over common axes.

    Args:
        lines: At most eight.
        title: What is shown, for those who cannot see it.
    """
    top = _TOP + 20 * _legend_rows(lines)
    across = _Scale(np.concatenate([line.x for line in lines]), _LEFT, WIDTH - _RIGHT, x)
    up = _Scale(np.concatenate([line.y for line in lines]), HEIGHT - _BOTTOM, top, y)
    drawn = Markup("").join(_curve(k, line, across, up) for k, line in enumerate(lines))
    return _picture(title, _axes(across, up, top) + drawn + _legend(lines))


def histogram(edges: FloatArray, counts: FloatArray, x: Axis, y: Axis, title: str = "") -> Markup:
    """Bars.

    Args:
        edges: Of the classes, shape (n + 1,).
        counts: Shape (n,).
        title: What is shown, for those who cannot see it.
    """
    across = _Scale(edges, _LEFT, WIDTH - _RIGHT, x)
    up = _Scale(np.array([0.0, max(counts.max(initial=0.0), 1.0)]), HEIGHT - _BOTTOM, _TOP, y)
    bars = Markup("").join(
        Markup(
            '<rect class="bar" x="{}" y="{}" width="{}" height="{}"><title>{}</title></rect>'
        ).format(
            _place(across(a) + 0.5),
            _place(up(count)),
            _place(max(across(b) - across(a) - 1, 0.5)),
            _place(up(0) - up(count)),
            f"{number(a)} to {number(b)}: {number(count)}",
        )
        for a, b, count in zip(edges[:-1], edges[1:], counts, strict=True)
    )
    return _picture(title, _axes(across, up, _TOP) + bars)


def _picture(title: str, inner: Markup) -> Markup:
    return Markup(
        '<svg class="chart" viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>'
    ).format(WIDTH, HEIGHT, title, inner)


def _axes(across: _Scale, up: _Scale, top: float) -> Markup:
    bottom, right = HEIGHT - _BOTTOM, WIDTH - _RIGHT
    parts = []
    for tick in up.ticks:
        at = _place(up(tick))
        parts.append(Markup('<path class="grid" d="M{} {}H{}"/>').format(_LEFT, at, right))
        parts.append(_label(_LEFT - 6, up(tick) + 4, up.text(tick), "end"))
    for tick in _spaced(across):
        at = _place(across(tick))
        parts.append(Markup('<path class="grid" d="M{} {}V{}"/>').format(at, _place(top), bottom))
        parts.append(_label(across(tick), bottom + 17, across.text(tick), "middle"))
    parts.append(_label((_LEFT + right) / 2, HEIGHT - 10, across.axis.label, "middle", "name"))
    middle = _place((top + bottom) / 2)
    turned = Markup(
        '<text class="name" text-anchor="middle" transform="translate(13 {}) rotate(-90)">{}</text>'
    )
    parts.append(turned.format(middle, up.axis.label))
    return Markup("").join(parts)


def _spaced(scale: _Scale) -> list[float]:
    """Ticks whose labels do not touch each other."""
    texts = [scale.text(tick) for tick in scale.ticks]
    room = abs(scale(scale.ticks[1]) - scale(scale.ticks[0])) if len(texts) > 1 else WIDTH
    needed = _ADVANCE * max(map(len, texts)) + 8
    return scale.ticks[:: max(1, math.ceil(needed / room))]


def _label(x: float, y: float, text: str, anchor: str, kind: str = "tick") -> Markup:
    tag = '<text class="{}" x="{}" y="{}" text-anchor="{}">{}</text>'
    return Markup(tag).format(kind, _place(x), _place(y), anchor, text)


def _curve(which: int, line: Line, across: _Scale, up: _Scale) -> Markup:
    x, y = _thinned(line.x, line.y)
    path, pen = [], "M"
    for a, b in zip(x, y, strict=True):
        if not (math.isfinite(a) and math.isfinite(b)) or (up.axis.logarithmic and b <= 0):
            pen = "M"
            continue
        path.append(f"{pen}{_place(across(a))} {_place(up(b))}")
        pen = "L"
    drawn = Markup('<path class="line line-{}" d="{}"/>').format(which % 8, "".join(path))
    if len(x) > 24:
        return drawn
    dots = (
        Markup('<circle class="dot dot-{}" cx="{}" cy="{}" r="2.6"/>').format(
            which % 8, *part[1:].split(" ")
        )
        for part in path
    )
    return drawn + Markup("").join(dots)


def _thinned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The points of a line, or the lowest and highest of each part of it."""
    if len(x) <= _MOST:
        return x, y
    kept = {0, len(x) - 1}
    for part in np.array_split(np.arange(len(x)), _MOST // 2):
        values = np.nan_to_num(y[part])
        kept |= {int(part[values.argmin()]), int(part[values.argmax()])}
    rows = np.array(sorted(kept))
    return x[rows], y[rows]


def _legend_places(lines: Sequence[Line]) -> list[tuple[float, int]]:
    """Left end and row of each line's name."""
    result, x, row = [], float(_LEFT), 0
    for line in lines:
        wide = 26 + _ADVANCE * len(_short(line.name))
        if x > _LEFT and x + wide > WIDTH - _RIGHT:
            x, row = float(_LEFT), row + 1
        result.append((x, row))
        x += wide + 10
    return result


def _legend_rows(lines: Sequence[Line]) -> int:
    return _legend_places(lines)[-1][1] + 1 if any(line.name for line in lines) else 0


def _legend(lines: Sequence[Line]) -> Markup:
    if not any(line.name for line in lines):
        return Markup("")
    parts = []
    for k, (line, (x, row)) in enumerate(zip(lines, _legend_places(lines), strict=True)):
        y, stroke = 14 + 20 * row, Markup('<path class="line line-{}" d="M{} {}h18"/>')
        parts.append(stroke.format(k % 8, _place(x), y - 4))
        parts.append(_label(x + 23, y, _short(line.name), "start"))
    return Markup("").join(parts)


def _short(name: str) -> str:
    return name if len(name) <= 40 else f"{name[:39]}…"


def _place(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")
