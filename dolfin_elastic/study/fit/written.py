"""What a fit leaves: the table of the material, a picture, and tables of constants and curves."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.case.toml import block, changed_tables, key_text
from dolfin_elastic.core.si_text import literal, percent
from dolfin_elastic.core.startup.elsewhere import plain_matplotlib
from dolfin_elastic.core.units import number_and_unit, stress_unit, to_base
from dolfin_elastic.results.files import drafted, make_folder, replace_text
from dolfin_elastic.study.fit.constants import place_in
from dolfin_elastic.study.fit.curves import KINDS
from dolfin_elastic.study.fit.fit import Fit, FittedCurve
from dolfin_elastic.study.least_squares.fitted import FittedConstant, constants_csv

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DIGITS = 7
_COLUMNS = 3


def material_toml(name: str, fit: Fit) -> str:
    """A table [materials.NAME] that a case file can have: what was not fitted stays as it was."""
    tests = ", ".join(map(_described, fit.curves))
    values: dict[str, object] = {
        "source": f"fitted to {tests}; r.m.s. error over the largest stress"
    }
    for row in fit.fitted:
        key, given = place_in(fit.table, row.name)
        values[key] = _written(row, given)
    table = changed_tables(fit.table, values, frozenset())
    return block(f"[materials.{key_text(name)}]", table) + "\n"


def _described(curve: FittedCurve) -> str:
    """A test with its error, such as "uniaxial a.csv (1.7 %)"."""
    file = Path(curve.measured.source).name
    return f"{curve.measured.kind} {file} ({percent(curve.relative)})".replace("  ", " ")


def _written(row: FittedConstant, given: object) -> str | float:
    """A number as a case file has it.

    Args:
        given: What it takes the place of, whose unit it has; of "fit" moduli and times have one.
    """
    if (read := number_and_unit(given)) is not None:
        number = row.value / (to_base(f"1 {read[1]}") if read[1] else 1.0)
        text = f"{number:.{_DIGITS}g}"
        return f"{text} {read[1]}" if read[1] else float(text)
    if row.unit == "Pa":
        size, unit = stress_unit(abs(row.value))
        return f"{row.value / size:.{_DIGITS}g} {unit}"
    if row.unit:
        return f"{row.value:.{_DIGITS}g} {row.unit}"
    return float(f"{row.value:.{_DIGITS}g}")


def files_of(name: str, folder: Path) -> list[Path]:
    """The files of a fit: table, constants, curves and picture.

    Args:
        name: Of the material; the names of all files begin with it.
    """
    begin = "".join(c if c.isalnum() or c in "-_" else "_" for c in name)
    return [folder / f"{begin}{end}" for end in (".toml", "_constants.csv", "_curves.csv", ".png")]


def write_fit(name: str, fit: Fit, folder: Path) -> list[Path]:
    """Writes all files of a fit. Not collective.

    Args:
        name: See `files_of`.
        folder: Where they go; made if missing.

    Returns:
        The files.

    Raises:
        OutputError: Something cannot be written.
    """
    make_folder(folder)
    paths = files_of(name, folder)
    replace_text(paths[0], material_toml(name, fit))
    replace_text(paths[1], constants_csv(fit.fitted, fit.correlation))
    replace_text(paths[2], _curves(fit))
    _draw(name, fit, paths[3])
    return paths


def _curves(fit: Fit) -> str:
    """What was measured beside the law, as CSV."""
    lines = ["test,x,time,measured,fitted"]
    for curve in fit.curves:
        test = curve.measured
        times = np.full(len(test.x), np.nan) if test.time is None else test.time
        for x, t, a, b in zip(test.x, times, test.stress, curve.stress, strict=True):
            time = f"{t:.10g}" if math.isfinite(t) else ""
            lines.append(f"{test.kind},{x:.10g},{time},{a:.10g},{b:.10g}")
    return "\n".join(lines) + "\n"


@plain_matplotlib()
def _draw(name: str, fit: Fit, path: Path) -> None:
    """One panel for each test."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    across = min(len(fit.curves), _COLUMNS)
    down = -(-len(fit.curves) // across)
    figure = Figure(figsize=(1 + 4.2 * across, 3.6 * down), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for axis, curve in zip(axes, fit.curves, strict=False):
        _panel(axis, curve)
    for axis in axes[len(fit.curves) :]:
        axis.axis("off")
    figure.suptitle(literal(name))
    with drafted(path) as draft:
        figure.savefig(draft, dpi=130, format=path.suffix[1:])


def _panel(axis: Axes, curve: FittedCurve) -> None:
    test = curve.measured
    size, unit = stress_unit(float(np.abs(test.stress).max()))
    over_time = test.kind == "relaxation"
    assert not over_time or test.time is not None
    x = test.time if over_time and test.time is not None else test.x
    axis.plot(x, test.stress / size, "o", color="#b0562f", markersize=4, label="measured")
    line = (x, curve.stress) if curve.line is None else curve.line
    axis.plot(line[0], line[1] / size, color="#1f5f8b", label="fitted")
    head = "time [s]" if over_time else KINDS[test.kind].columns[0][0]
    sheared = test.kind in ("shear", "volumetric")
    what = "stress" if sheared else "Cauchy stress" if test.true else "nominal stress"
    axis.set(title=f"{test.kind}, r.m.s. {percent(curve.relative)}", xlabel=head)
    axis.set_ylabel(f"{what} [{unit}]")
    if over_time and x.min() > 0 and x.max() > 30 * x.min():
        axis.set_xscale("log")
    axis.grid(color="#dde1e5")
    axis.legend(fontsize=8)
