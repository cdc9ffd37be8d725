"""Curves of a finished run: columns of its history, and fields along lines, as pictures and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dolfin_elastic.core.errors import InputError, nearest
from dolfin_elastic.core.si_text import literal
from dolfin_elastic.core.startup.elsewhere import elsewhere, plain_matplotlib
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.results.fields import FIELDS
from dolfin_elastic.results.files import drafted, make_folder, replace_text
from dolfin_elastic.results.finished.draw import check_field, shown
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.scene.colour_bar import prefixed
from dolfin_elastic.results.scene.scene import label_of

POINTS = 201
"""Points of a line or circle."""
NORM = "_norm"
"""Behind the name of a tensor, of which the norm is told."""
_TOLERANCE = 1e-6
"""Distance from the body that still counts as inside, over the body's length."""
_INWARD = 1e-9
"""Way towards the middle of an element at which its values are read."""


@dataclass(frozen=True)
class Axis:
    """Numbers along an axis, or of a curve.

    Attributes:
        name: What they are.
        values: SI units, shape (n,).
        unit: SI unit.
    """

    name: str
    values: FloatArray
    unit: str = ""


@dataclass(frozen=True)
class Curves:
    """Curves over one axis.

    Attributes:
        over: The axis.
        curves: The curves.
        title: Above the picture.
    """

    over: Axis
    curves: Sequence[Axis]
    title: str = ""


def history_curves(run: FinishedRun, over: str, names: Sequence[str]) -> Curves:
    """Columns of history.csv.

    Raises:
        InputError: There is no such column.
    """
    return Curves(_column(run, over), [_column(run, n) for n in names], _title(run))


def _title(run: FinishedRun) -> str:
    return str(run.case.get("title", ""))


def _column(run: FinishedRun, name: str) -> Axis:
    if name not in run.history:
        raise InputError(
            f"history.csv has no column '{name}'",
            where=f"{run.folder}: --curve",
            expected=nearest(name, run.history),
        )
    shown_as = ("time" if run.timed else "load parameter") if name == "t" else name
    return Axis(shown_as, run.history[name], run.units[name])


def line(start: Sequence[float], end: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    """Points of a line and their distance from its start [m].

    Args:
        start: Its beginning [m].
    """
    share = np.linspace(0, 1, POINTS, dtype=np.float64)
    a, b = np.array(start, dtype=float), np.array(end, dtype=float)
    return a + share[:, None] * (b - a), np.asarray(share * float(np.linalg.norm(b - a)))


def circle(
    centre: Sequence[float], radius: float, normal: Sequence[float]
) -> tuple[FloatArray, FloatArray]:
    """Points of a circle and their angles [rad], from the first of x, y, z across the normal.

    Args:
        centre: Its middle [m].
        radius: Its radius [m].
    """
    n = np.array(normal, dtype=float) / np.linalg.norm(normal)
    first = next(axis for axis in np.eye(3) if abs(axis @ n) < 0.9)
    a = first - (first @ n) * n
    a /= np.linalg.norm(a)
    turn = np.linspace(0, 2 * np.pi, POINTS, dtype=np.float64)
    x = np.cos(turn)[:, None] * a + np.sin(turn)[:, None] * np.cross(n, a)
    return np.asarray(np.array(centre, dtype=float) + radius * x), np.asarray(
        turn, dtype=np.float64
    )


def along(
    run: FinishedRun, names: Sequence[str], points: FloatArray, over: Axis, step: int = -1
) -> Curves:
    """Fields at points of the undeformed body, nan outside.

    Args:
        names: Of fields; of vectors all components, of tensors the norm.
        points: Shape (n, 3) [m].
        over: Distance or angle of each.
        step: See `FinishedRun.frame`.

    Raises:
        InputError: There is no such field or step, or all points lie outside.
    """
    with elsewhere():
        import pyvista as pv

    for name in names:
        check_field(run, name, step)
    grid = run.grid(step)
    if any(run.frame(step).arrays[name].centre == "cell" for name in names):
        grid = grid.cell_data_to_point_data()
    # VTK misses points that lie exactly on a face of a quadratic element.
    cells, nearest = grid.find_closest_cell(points, return_closest_point=True)
    near = np.linalg.norm(nearest - points, axis=1) <= _TOLERANCE * grid.length
    inward = _INWARD * (grid.cell_centers().points[cells] - points)
    moved = np.where(near[:, None], points + inward, points)
    sampled = pv.PolyData(moved).sample(grid, tolerance=_TOLERANCE * grid.length)
    inside = np.asarray(sampled.point_data["vtkValidPointMask"]).astype(bool)
    if not inside.any():
        raise InputError(
            "all its points lie outside the body",
            where=f"{run.folder}: --{'line' if over.unit == 'm' else 'circle'}",
            expected=f"coordinates [m] of the undeformed body, which fills {_box(grid.bounds)}",
        )
    curves = []
    for name in names:
        field = FIELDS.get(name)
        unit, values = field.unit if field else "", np.asarray(sampled.point_data[name])
        if values.ndim == 2 and values.shape[1] == 3:
            parts = [(f"{name}_{axis}", values[:, i]) for i, axis in enumerate("xyz"[: run.dim])]
        else:
            norm = NORM if values.ndim == 2 else ""
            parts = [(f"{name}{norm}", shown(sampled.point_data, name))]
        curves += [Axis(n, np.where(inside, v, np.nan), unit) for n, v in parts]
    return Curves(over, curves, _title(run))


def _box(bounds: Sequence[float]) -> str:
    pairs = zip("xyz", bounds[::2], bounds[1::2], strict=True)
    size = max(abs(bound) for bound in bounds)
    shown_as = [
        (axis, *(0.0 if abs(b) < 1e-9 * size else b for b in ends)) for axis, *ends in pairs
    ]
    return ", ".join(f"{axis} from {low:.4g} to {high:.4g}" for axis, low, high in shown_as)


def write_csv(curves: Curves, file: Path) -> None:
    """Writes curves as a table in SI units, the units in the names of the columns.

    Args:
        file: The CSV file.

    Raises:
        OutputError: It cannot be written.
    """
    text = io.StringIO(newline="")
    table = csv.writer(text)
    columns = [curves.over, *curves.curves]
    table.writerow([f"{c.name} [{c.unit}]" if c.unit else c.name for c in columns])
    table.writerows(zip(*(c.values.tolist() for c in columns), strict=True))
    replace_text(file, text.getvalue())


@plain_matplotlib()
def draw_curves(curves: Curves, file: Path) -> None:
    """Draws curves, each unit with an axis of its own where there are two.

    Raises:
        OutputError: It cannot be written.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 5.0), dpi=160, layout="constrained")
    axes = figure.add_subplot()
    units = list(dict.fromkeys(curve.unit for curve in curves.curves))
    x, factor, unit = _scaled([curves.over])
    axes.set_xlabel(_label(curves.over.name, unit))
    shown_axes = {units[0]: axes}
    for other in units[1:]:
        shown_axes[other] = axes.twinx()
    handles = []
    for i, curve in enumerate(curves.curves):
        _, scale, prefix = _scaled([c for c in curves.curves if c.unit == curve.unit])
        place = shown_axes[curve.unit]
        few = len(curve.values) <= 40
        handles += place.plot(
            x[0] / factor,
            curve.values / scale,
            color=f"C{i}",
            marker="o" if few else None,
            markersize=4,
            label=literal(_name(curve.name)),
        )
        same = [c.name for c in curves.curves if c.unit == curve.unit]
        place.set_ylabel(_label(same[0] if len(same) == 1 else "", prefix))
    if len(curves.curves) > 1:
        # Outside, where no curve is: of two pairs of axes matplotlib avoids the lines of one only.
        figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 3))
    axes.grid(alpha=0.3)
    axes.set_title(literal(curves.title), fontsize=11)
    make_folder(file.parent)
    with drafted(file) as draft:
        figure.savefig(draft, format=file.suffix[1:])


def _scaled(curves: Sequence[Axis]) -> tuple[list[FloatArray], float, str]:
    """Values, and the factor and unit in which the largest is between 1 and 1000."""
    largest = max((float(np.nanmax(np.abs(c.values), initial=0.0)) for c in curves), default=0.0)
    factor, unit = prefixed(largest, curves[0].unit)
    return [curve.values for curve in curves], factor, unit


def _name(name: str) -> str:
    """Name of a curve for people."""
    tensor = name.removesuffix(NORM)
    normed = tensor != name and tensor in FIELDS
    return f"norm of the {label_of(tensor)}" if normed else label_of(name)


def _label(name: str, unit: str) -> str:
    text = literal(_name(name))
    powers = unit.replace("^2", "\u00b2").replace("^3", "\u00b3")
    return f"{text} [{powers}]".strip() if unit else text
