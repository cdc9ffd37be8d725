"""What gradients tell: derivatives of numbers by parameters, and tables of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.core.si_text import literal, quantity
from dolfin_elastic.core.startup.elsewhere import plain_matplotlib
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.results.files import drafted
from dolfin_elastic.study.tabled import Tabled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

T = TypeVar("T")


def _of_name(known: Mapping[str, T], name: str, what: str) -> T:
    if name not in known:
        raise InputError(f"there is no {what} '{name}'", expected=nearest(name, known))
    return known[name]


@dataclass(frozen=True)
class Derivative:
    """Of one number by one parameter.

    Attributes:
        key: Of the parameter.
        at: The parameter's value.
        unit: Of the parameter, as the case has it, or that of a bare number there; empty of pure
            numbers.
        value: dQ/dm, the SI unit of Q over `unit`.
        size: In `unit`, over which Q may well change: of the parameter, of its distance from what
            is impossible, or of a cell.
        order: With which Taylor's remainder falls with the step, 2 of a right derivative; nan
            where nobody has looked, or where nothing but round-off is left of it.
        room: By how much the parameter may be larger, in `unit`.
    """

    key: str
    at: float
    unit: str
    value: float
    size: float
    order: float = math.nan
    room: float = math.inf


@dataclass(frozen=True)
class Gradient:
    """Of one number.

    Attributes:
        name: What it is.
        value: Of it.
        unit: SI.
        by: Its derivatives.
        cells: Key of a constant to dQ/d ln m of each owned cell, in the unit of Q.
        nodes: dQ/dX at the local nodes of the mesh's geometry, ghosts included, shape (nodes, dim),
            unit of Q per m; None where no surface moves.
    """

    name: str
    value: float
    unit: str
    by: tuple[Derivative, ...]
    cells: Mapping[str, FloatArray] = field(default_factory=dict)
    nodes: FloatArray | None = None

    def __getitem__(self, key: str) -> Derivative:
        """The derivative by a parameter.

        Raises:
            InputError: It is not among those that were asked for.
        """
        return _of_name({one.key: one for one in self.by}, key, "derivative by")


@dataclass(frozen=True)
class GradientTable(Tabled):
    """Gradients of several numbers.

    Attributes:
        gradients: One for each number.
    """

    gradients: tuple[Gradient, ...]

    def __getitem__(self, name: str) -> Gradient:
        """The gradient of a number.

        Raises:
            InputError: It is not among those that were asked for.
        """
        return _of_name({one.name: one for one in self.gradients}, name, "gradient of")

    def columns(self) -> dict[str, list[object]]:
        """The table by columns, a row for each number and parameter."""
        rows = [(one, d) for one in self.gradients for d in one.by]
        return {
            "number": [one.name for one, _ in rows],
            "value": [one.value for one, _ in rows],
            "unit": [one.unit for one, _ in rows],
            "parameter": [d.key for _, d in rows],
            "at": [d.at for _, d in rows],
            "parameter_unit": [d.unit for _, d in rows],
            "derivative": [d.value for _, d in rows],
            "relative": [relative(one, d) for one, d in rows],
            "taylor_order": [d.order for _, d in rows],
        }

    @property
    def drawable(self) -> bool:
        """There is something to draw."""
        return any(math.isfinite(relative(one, d)) for one in self.gradients for d in one.by)

    def plot(self, file: str | PathLike[str]) -> None:
        """Draws bars: by how much numbers change where a parameter is 1 % larger. Not collective.

        Raises:
            OutputError: The picture cannot be written.
        """
        _draw(self, Path(file))


_MOST = 12
"""Bars of one number."""
_INK = ("#1f5f8b", "#b0562f")
"""Of bars to the right and to the left."""
_NOTHING = 1e-7
"""Relative derivative below which it is round-off."""


def relative(one: Gradient, derivative: Derivative) -> float:
    """m/Q dQ/dm: by how many per cent Q changes where m is 1 % larger; nan where one is 0."""
    if not (one.value and derivative.at):
        return math.nan
    result = derivative.at * derivative.value / one.value
    return result if abs(result) > _NOTHING else 0.0


def told_change(one: Gradient, derivative: Derivative) -> tuple[float, str]:
    """Change of Q in per cent where m is 1 % larger, or by less where so large a one cannot be.

    Returns:
        It, nan where `relative` is; and by how much m is larger, empty: by 1 %.
    """
    change, at, room = relative(one, derivative), derivative.at, derivative.room
    if not at or 0.01 * abs(at) < room:
        return change, ""
    step = 10.0 ** math.floor(math.log10(room / 2))
    by = f"{math.copysign(step, at):+g} {derivative.unit}".rstrip()
    return change * 100 * step / abs(at), by


@plain_matplotlib()
def _draw(table: GradientTable, path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels = [
        (one, sorted(rows, key=lambda row: abs(row[1]))[-_MOST:])
        for one in table.gradients
        if (rows := _bars(one))
    ]
    heights = [0.5 + 0.32 * len(rows) for _, rows in panels]
    figure = Figure(figsize=(7, 0.6 + sum(heights) + 0.5 * len(panels)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(panels), 1, squeeze=False, height_ratios=heights)[:, 0]
    for axis, (one, rows) in zip(axes, panels, strict=True):
        axis.set_title(literal(f"{one.name} = {quantity(one.value, one.unit)}"), fontsize=10)
        draw_bars(axis, rows)
    axes[-1].set_xlabel("change [%] where the parameter is 1 % larger")
    with drafted(path) as draft:
        figure.savefig(draft, format="png", dpi=130)


def _bars(one: Gradient) -> list[tuple[str, float]]:
    """Key and change [%] of each parameter that has one."""
    rows = [(d.key, *told_change(one, d)) for d in one.by]
    return [(f"{key} ({by})" if by else key, r) for key, r, by in rows if math.isfinite(r)]


def draw_bars(axis: Axes, rows: Sequence[tuple[str, float]]) -> None:
    """Draws relative derivatives into a panel, in one colour where they are negative.

    Args:
        rows: Key of each, and its value [%].
    """
    values = [value for _, value in rows]
    inks = [_INK[value < 0.0] for value in values]
    axis.barh([literal(key) for key, _ in rows], values, color=inks, height=0.6)
    axis.axvline(0.0, color="0.3", linewidth=0.8)
    low, high = min(0.0, *values), max(0.0, *values)
    beside = 0.25 * (high - low or 1.0)  # for the numbers, those of short bars, too
    axis.set_xlim(low - beside * (low < 0.0), high + beside)
    axis.tick_params(axis="y", length=0)
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    for place, value in enumerate(values):
        axis.annotate(
            f"{value:+.2g} %".replace("-", "\N{MINUS SIGN}") if value else "0",
            (value, place),
            xytext=(4 if value >= 0 else -4, 0),
            textcoords="offset points",
            va="center",
            ha="left" if value >= 0 else "right",
            fontsize=8,
        )
