"""What a fit of a case leaves: the case with its values, a picture, tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.restart import tables_in
from dolfin_elastic.case.toml import changed_tables, toml_text
from dolfin_elastic.core.si_text import literal, percent, scaled_unit
from dolfin_elastic.core.startup.elsewhere import plain_matplotlib
from dolfin_elastic.core.types import AnyArray, FloatArray
from dolfin_elastic.results.files import drafted, make_folder, replace_text
from dolfin_elastic.study.identify.identify import ComparedSet, Identified
from dolfin_elastic.study.identify.measured import MeasuredCurve, MeasuredField
from dolfin_elastic.study.least_squares.fitted import constants_csv

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DIGITS = 7
_COLUMNS = 3
_AXES = ("x", "y", "z")


def values_text(found: Identified) -> dict[str, object]:
    """Keys to values with as many digits as a reader wants."""
    pairs = zip(found.unknowns, found.constants, strict=True)
    return {one.key: one.written(row.value, _DIGITS) for one, row in pairs}


def files_of(name: str, folder: Path) -> list[Path]:
    """The files that a fit of a case, or the search for a field, may write.

    Args:
        name: Of the case; the names of all files begin with it.
    """
    ends = (".toml", "_constants.csv", "_curves.csv", "_points.csv", "_field.xdmf", ".png")
    return [folder / f"{name}{end}" for end in ends]


def write_identified(found: Identified, folder: Path) -> list[Path]:
    """Writes all files of a fit. Not collective.

    Args:
        folder: Where they go; made if missing.

    Returns:
        The files.

    Raises:
        OutputError: Something cannot be written.
    """
    make_folder(folder)
    name = found.case.name
    texts = {".toml": case_text(found.case, values_text(found), folder)}
    texts["_constants.csv"] = constants_csv(found.constants, found.correlation)
    if _curves(found):
        texts["_curves.csv"] = _curve_rows(found)
    if len(_curves(found)) < len(found.sets):
        texts["_points.csv"] = point_rows(found.sets, {})
    paths = {end: folder / f"{name}{end}" for end in (*texts, ".png")}
    for end, text in texts.items():
        replace_text(paths[end], text)
    _draw(found, paths[".png"])
    return [*paths.values()]


def case_text(case: Case, values: Mapping[str, object], folder: Path) -> str:
    """A case with other values as a file in a folder, the rest as it was. Not collective."""
    try:
        return toml_text(changed_tables(tables_in(case, folder), values, frozenset()))
    except TypeError:
        return "# This case has Python functions, which no file holds.\n"


def _curves(found: Identified) -> list[ComparedSet]:
    return [one for one in found.sets if isinstance(one.measured, MeasuredCurve)]


def _curve_rows(found: Identified) -> str:
    """Curves as CSV, SI units."""
    lines = ["curve,x,measured,computed"]
    for number, one in enumerate(_curves(found), start=1):
        curve = one.measured
        assert isinstance(curve, MeasuredCurve)
        rows = zip(curve.at, curve.values, one.computed, strict=True)
        lines += [f"{number},{x:.10g},{a:.10g},{b:.10g}" for x, a, b in rows]
    return "\n".join(lines) + "\n"


def point_rows(sets: Sequence[ComparedSet], further: Mapping[str, Sequence[FloatArray]]) -> str:
    """Displacement fields as CSV, SI units.

    Args:
        further: Heading of a column to its numbers at the points of each set.
    """
    lines = [",".join(["field,t,x,y,z,component,measured,computed", *further])]
    fields = [one for one in sets if isinstance(one.measured, MeasuredField)]
    for number, one in enumerate(fields):
        field = one.measured
        assert isinstance(field, MeasuredField)
        for i, point in enumerate(field.points):
            t = f"{field.times[i]:.10g}" if np.isfinite(field.times[i]) else ""
            place = [*(f"{x:.10g}" for x in point), ""][:3]
            more = [f"{values[number][i]:.10g}" for values in further.values()]
            for c, component in enumerate(field.components):
                pair = f"{field.values[i, c]:.10g}", f"{one.computed[i, c]:.10g}"
                row = [str(number + 1), t, *place, f"u{_AXES[component]}", *pair, *more]
                lines.append(",".join(row))
    return "\n".join(lines) + "\n"


# --- the picture ---


@plain_matplotlib()
def _draw(found: Identified, path: Path) -> None:
    """One panel for each curve and field."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    across = min(len(found.sets), _COLUMNS)
    down = -(-len(found.sets) // across)
    figure = Figure(figsize=(1 + 4.2 * across, 3.6 * down), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for axis, one in zip(axes, found.sets, strict=False):
        if isinstance(one.measured, MeasuredCurve):
            _curve_panel(axis, one, one.measured)
        else:
            field_panel(figure, axis, one)
        axis.grid(color="#dde1e5")
    for axis in axes[len(found.sets) :]:
        axis.axis("off")
    figure.suptitle(literal(found.case.name))
    with drafted(path) as draft:
        figure.savefig(draft, dpi=130, format=path.suffix[1:])


def _curve_panel(axis: Axes, one: ComparedSet, curve: MeasuredCurve) -> None:
    wide, x_unit = scaled_unit(float(np.abs(curve.at).max()), curve.x.unit)
    size, unit = scaled_unit(float(np.abs(curve.values).max()), one.unit)
    axis.plot(
        curve.at / wide, curve.values / size, "o", color="#b0562f", markersize=4, label="measured"
    )
    assert one.line is not None
    axis.plot(one.line[0] / wide, one.line[1] / size, color="#1f5f8b", label="computed")
    axis.set_title(f"r.m.s. {percent(one.relative)}")
    axis.set_xlabel(literal(f"{curve.x.text} [{x_unit}]" if x_unit else curve.x.text))
    axis.set_ylabel(literal(f"{curve.y.text} [{unit}]" if unit else curve.y.text))
    axis.legend(fontsize=8)


def field_panel(figure: Figure, axis: Axes, one: ComparedSet) -> None:
    """How far the displacements are off at the points, seen along z."""
    field = one.measured
    assert not isinstance(field, MeasuredCurve)
    off: FloatArray = np.linalg.norm(one.computed - field.values, axis=1)
    size, unit = scaled_unit(float(off.max()), "m")
    points_panel(figure, axis, field.points, off / size, f"off [{unit}]")
    axis.set_title(literal(f"{field.label}, r.m.s. {percent(one.relative)}"))


def points_panel(
    figure: Figure, axis: Axes, points: FloatArray, values: AnyArray, label: str
) -> None:
    """Values at points in colours, seen along z.

    Args:
        points: [m], shape (n, dim).
        values: Shape (n,).
        label: Beside the colours, with the unit "[MPa]".
    """
    size, unit = scaled_unit(float(np.abs(points[:, :2]).max()), "m")
    shown = axis.scatter(points[:, 0] / size, points[:, 1] / size, c=values, s=12)
    figure.colorbar(shown, ax=axis, label=label)
    axis.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]", aspect="equal")
    axis.locator_params(nbins=5)
