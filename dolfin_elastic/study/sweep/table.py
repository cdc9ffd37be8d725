"""The files of a sweep: `sweep.csv`, `sweep.json` and `sweep.png`."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import compress
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.case.toml import key_parts
from dolfin_elastic.core.errors import SolveError
from dolfin_elastic.core.si_text import literal, number, percent, scaled_unit
from dolfin_elastic.core.startup.elsewhere import plain_matplotlib
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import number_and_unit
from dolfin_elastic.problem.material_regions import STIFF_IN_VOLUME
from dolfin_elastic.results.files import drafted, json_data, replace_text
from dolfin_elastic.study.sweep.numbers import NO_RESULT, UNKNOWN_ERROR, unit_of
from dolfin_elastic.study.sweep.rows import Row
from dolfin_elastic.study.sweep.settings import DRAWN, Design, short_names, worded
from dolfin_elastic.study.sweep.statistics import Statistics, statistics
from dolfin_elastic.study.tabled import Tabled, csv_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TABLE, SUMMARY, PLOT = FILES = ("sweep.csv", "sweep.json", "sweep.png")
_SOURCES = {"materials": "the material", "load": "the loads", "support": "the supports"}
_ANY = "what scatters"
_NO_ERROR = "it is estimated of stresses and the safety factor only"
_NOTHING, _SMALL = 1e-6, 1e-4
"""Deviation over the mean that is none, and size over the largest that is not shown first."""
_USEFUL = 64
"""Samples from which on Sobol's indices are worth something."""
_PAUSE = 99.0
"""Time between two tables over that which the first has taken."""
_MOST_PANELS, _MOST_LINES = 6, 8
_WIDTH, _HEIGHT, _GAP, _BESIDE, _BELOW, _ABOVE = 3.6, 2.0, 0.2, 0.95, 0.55, 0.22
"""Size of a panel of the plot, what is between two, room for names and numbers, and for a line of
the legend [inches]."""
_ENTRY = 2.2
"""Width of an entry of the legend [inches]."""
_GREY = "#8a929a"
_INK = ("#1f5f8b", "#b0562f", "#228833", "#7a3e9d", "#c79a00", "#444444", "#0f9d9d", "#d0527a")


@dataclass(frozen=True)
class Results(Tabled):
    """The rows of a sweep, all or those so far.

    Attributes:
        case: Name of its case file.
        folder: Of the sweep.
        design: What varies.
        rows: In the order of the design.
    """

    case: str
    folder: Path
    design: Design
    rows: tuple[Row, ...]

    @cached_property
    def names(self) -> list[str]:
        """Results that one row has at least."""
        return list(dict.fromkeys(name for row in self.rows for name in row.numbers))

    @cached_property
    def statistics(self) -> dict[str, Statistics]:
        """Of samples, see `statistics`."""
        return statistics(self.design, self.rows)

    @property
    def failed(self) -> list[Row]:
        """Rows without a solution."""
        return [row for row in self.rows if row.status == "failed"]

    @property
    def missing(self) -> int:
        """Runs that were not computed."""
        return sum(not row.ended for row in self.rows)

    def check(self) -> None:
        """At least one run has a solution.

        Raises:
            SolveError: None has one; with the first cause.
        """
        if len(self.failed) == len(self.rows):
            raise SolveError(f"no run of the sweep has a solution; the first: {self.rows[0].cause}")

    def columns(self) -> dict[str, list[object]]:
        """The table by columns, SI units; nan where a number is not known."""
        keys, names = [one.key for one in self.design.settings], self.names
        known = [name for name in names if any(name in row.errors for row in self.rows)]
        return {
            "run": [row.number for row in self.rows],
            **{key: [row.values.get(key) for row in self.rows] for key in keys},
            "status": [row.status for row in self.rows],
            "formulation": [row.formulation for row in self.rows],
            **{name: [row.numbers.get(name, math.nan) for row in self.rows] for name in names},
            **{
                f"{name}_error": [row.errors.get(name, math.nan) for row in self.rows]
                for name in known
            },
            "seconds": [row.seconds for row in self.rows],
            "folder": [row.folder for row in self.rows],
            "cause": [row.cause for row in self.rows],
            "remark": [
                "; ".join(f"{name}: {text}" for name, text in self._remarks_on(row).items())
                for row in self.rows
            ],
        }

    def _remarks_on(self, row: Row) -> Mapping[str, str]:
        """Its remarks, and why cells are empty: other rows have results that it does not have."""
        absent = [name for name in self.names if row.numbers and name not in row.numbers]
        return {**dict.fromkeys(absent, NO_RESULT), **row.remarks}

    def texts(self, most: int | None = None, *, errors: bool = True) -> dict[str, list[str]]:
        """The table for people: heads with units to the cells below them.

        Args:
            most: Results at most.
            errors: Beside a number the estimated error of the mesh.
        """
        names = self.names if most is None else self.large[:most]
        result = {"run": [str(row.number) for row in self.rows]}
        short = short_names([one.key for one in self.design.settings])
        for one in self.design.settings:
            x, unit, words = _abscissae([row.values.get(one.key) for row in self.rows])
            name, digits = short[one.key], 6 if one.spread is None else DRAWN
            if words:
                result[name] = [worded(row.values.get(one.key), one) for row in self.rows]
            else:
                result[f"{name} [{unit}]" if unit else name] = [f"{v:.{digits}g}" for v in x]
        for name in names:
            values = [row.numbers.get(name, math.nan) for row in self.rows]
            largest = max(_finite(map(abs, values)), default=0.0)
            factor, unit = scaled_unit(largest, unit_of(name))
            cells = [f"{v / factor:.5g}" if math.isfinite(v) else "" for v in values]
            known = [row.errors.get(name, math.nan) for row in self.rows]
            if errors:
                pairs = zip(cells, known, strict=True)
                cells = [f"{c} ± {percent(e)}" if math.isfinite(e) else c for c, e in pairs]
            result[f"{name} [{unit}]" if unit else name] = cells
        if len(self._formulations) > 1:
            result["formulation"] = [row.formulation for row in self.rows]
        result["status"] = [row.status for row in self.rows]
        return {**result, "folder": [row.folder for row in self.rows]}

    @cached_property
    def large(self) -> list[str]:
        """Results that are not zero, nor far smaller than others of their unit."""
        names = self.names
        size = {
            name: max(_finite(abs(row.numbers.get(name, 0.0)) for row in self.rows), default=0.0)
            for name in names
        }
        most = dict[str, float]()
        for name in names:
            most[unit_of(name)] = max(most.get(unit_of(name), 0.0), size[name])
        return [name for name in names if size[name] > _SMALL * most[unit_of(name)]]

    def remarks(self) -> list[str]:
        """What is to be known of results, each once, with the runs that it is of."""
        return [*self._jumps(), *self._remarks_on_results()]

    @cached_property
    def _formulations(self) -> dict[str, list[int]]:
        """Formulation to the numbers of the runs that have results with it."""
        runs = dict[str, list[int]]()
        for row in self.rows:
            if row.numbers and row.formulation:
                runs.setdefault(row.formulation, []).append(row.number)
        return runs

    def _jumps(self) -> list[str]:
        """That some runs have a pressure among their unknowns, unless this is what varies."""
        runs = self._formulations
        if len(runs) < 2 or any(one.key == "mesh.formulation" for one in self.design.settings):
            return []
        each = ", ".join(f"{text} (run {', '.join(map(str, of))})" for text, of in runs.items())
        # "mixed" gives all materials a pressure where none is nearly incompressible, else only
        # those that are: with one more that is not, no two runs are alike then.
        alike = "mixed" if runs.keys() == {"displacement", "mixed"} else "displacement"
        return [
            f"formulation: {each}: a pressure is an unknown where nu exceeds {STIFF_IN_VOLUME:g}, "
            "and results jump there by the error of the mesh; "
            f'mesh.formulation = "{alike}" makes all runs alike'
        ]

    def _remarks_on_results(self) -> list[str]:
        runs = dict[tuple[str, str], list[int]]()
        for row in self.rows:
            for name, text in self._remarks_on(row).items():
                runs.setdefault((name, text), []).append(row.number)
        every = len([row for row in self.rows if row.numbers])
        return [
            f"{name}: {text}" + ("" if len(of) == every else f" (run {', '.join(map(str, of))})")
            for (name, text), of in runs.items()
        ]

    def plot(self, file: str | PathLike[str]) -> None:
        """Draws each result over what varies most. Not collective.

        Raises:
            OutputError: The picture cannot be written.
        """
        draw(self, Path(file))

    def lines(self) -> list[str]:
        """What samples say of each result, for people."""
        short = short_names([one.key for one in self.design.settings])
        kinds, result = {key_parts(key)[0] for key in short}, list[str]()
        source = _SOURCES.get(kinds.pop(), _ANY) if len(kinds) == 1 else _ANY
        drawn = 2 * self.design.base or len(self.rows)
        for name, of in self.statistics.items():
            numbers = [of.mean, 2 * of.deviation, of.percentiles[5], of.percentiles[95], of.mesh]
            factor, unit = scaled_unit(max(map(abs, numbers[:4])), unit_of(name))
            mean, deviation, low, high, error = (
                f"{number(value / factor)} {unit}".rstrip() for value in numbers
            )
            mesh = f"± {error}" if math.isfinite(of.mesh) else f"not known: {self._why(name)}"
            spread = (
                f"± {deviation} from {source} (2 standard deviations; 90 % from {low} to {high})"
            )
            if of.deviation <= _NOTHING * abs(of.mean):
                spread = f"{source} does not change it"
            so_far = "" if of.samples == drawn else f", {of.samples} of {drawn} samples so far"
            result.append(f"{name}: {mean}, {spread}, from the mesh {mesh}{so_far}")
            for key, index in of.sobol.items():
                result.append(
                    f"  {short[key]}: {percent(index.first)} of the variance alone, "
                    f"{percent(index.total)} ± {percent(index.error)} with the others (Sobol)"
                )
        if 0 < self.design.base < _USEFUL:
            base = self.design.base
            result.append(f"Sobol's indices of {base} samples are coarse: --sobol {_USEFUL}")
        return result

    def _why(self, name: str) -> str:
        """Why the error of the mesh is not known of a result."""
        has = [row for row in self.rows if name in row.numbers]
        rows = [row for row in has if not math.isfinite(row.errors.get(name, math.nan))]
        told = (row.remarks[name] for row in rows if name in row.remarks)
        return next(told, _NO_ERROR).removeprefix(UNKNOWN_ERROR)


class TableAtTimes:
    """Writes the table while runs go on, so seldom that it takes a hundredth of the time at most.

    After every row, writing n rows n times would take longer than many small runs.
    """

    def __init__(self) -> None:
        self._next = 0.0

    def write(self, results: Callable[[], Results]) -> None:
        """Writes all files but the plot anew, or leaves them as they are. Not collective.

        Raises:
            OutputError: They cannot be written.
        """
        if (begin := time.monotonic()) < self._next:
            return
        write_table(results(), plot=False)
        end = time.monotonic()
        self._next = end + _PAUSE * (end - begin)


def _finite(values: Iterable[float]) -> list[float]:
    return [value for value in values if math.isfinite(value)]


def write_table(results: Results, *, plot: bool) -> None:
    """Writes all files anew. Not collective.

    Args:
        plot: Without, the plot stays as it is, for drawing takes time.

    Raises:
        OutputError: They cannot be written.
    """
    folder = results.folder
    replace_text(folder / TABLE, csv_text(results.columns()))
    text = json.dumps(json_data(_summary(results)), indent=2, allow_nan=False, default=str)
    replace_text(folder / SUMMARY, text + "\n")
    if plot and results.large:
        draw(results, folder / PLOT)


def _summary(results: Results) -> dict[str, object]:
    columns = results.columns()
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    return {
        "case": results.case,
        "settings": [one.key for one in results.design.settings],
        "units": {name: unit_of(name) for name in results.names},
        "rows": rows,
        "remarks": results.remarks(),
        "statistics": {name: asdict(one) for name, one in results.statistics.items()},
    }


# --- the plot ---


@plain_matplotlib()
def draw(results: Results, path: Path) -> None:
    """Each result over what varies most: of several settings a column each. Not collective.

    Panels of a column have one abscissa, and of several settings those of a row one ordinate.

    Raises:
        OutputError: It cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    over = _over(results)
    pairs = [(name, key) for name in results.large[:_MOST_PANELS] for key in over]
    several = len(over) > 1
    across = len(over) if several else min(3, len(pairs))
    down = -(-len(pairs) // across)
    # A layout that measures names and numbers takes 30 ms a panel.
    between = _GAP if several else _BESIDE
    width = _BESIDE + across * _WIDTH + (across - 1) * between + _GAP
    labels = list(_groups(results, results.rows, over[0]))
    labels = labels if 1 < len(labels) <= _MOST_LINES else []
    bars = any(row.errors.get(name, 0.0) > 0 for name, _ in pairs for row in results.rows)
    columns = max(1, int(width / _ENTRY))
    above = _GAP + _ABOVE * -(-(len(labels) + bars) // columns)
    height = _BELOW + down * _HEIGHT + (down - 1) * _GAP + above
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        down,
        across,
        left=_BESIDE / width,
        right=1 - _GAP / width,
        bottom=_BELOW / height,
        top=1 - above / height,
        wspace=between / _WIDTH,
        hspace=_GAP / _HEIGHT,
    )
    panels = grid.subplots(sharex="col", sharey="row" if several else False, squeeze=False).ravel()
    for n, (panel, pair) in enumerate(zip(panels, pairs, strict=False)):
        lowest, first = n + across >= len(pairs), n % across == 0 or not several
        _panel(panel, results, *pair, below=lowest, beside=first)
    for panel in panels[len(pairs) :]:
        panel.remove()
    _legend(figure, labels, columns, bars=bars)
    with drafted(path) as draft:
        figure.savefig(draft, dpi=110, format=path.suffix[1:])


def _over(results: Results) -> list[str]:
    """Settings over which results are drawn: of samples each, else that with most values."""
    settings = results.design.settings
    if results.design.scatter:
        return [one.key for one in results.design.scatter][:4]
    return [max(settings, key=lambda one: len(one.values)).key]


def _groups(results: Results, rows: Sequence[Row], key: str) -> dict[str, list[int]]:
    """Indices of the rows of each line over a setting, by what the other settings have."""
    others = [one for one in results.design.settings if one.key != key]
    short = short_names([one.key for one in results.design.settings])
    if results.design.scatter or results.design.together:
        others = []
    groups: dict[str, list[int]] = {}
    for k, row in enumerate(rows):
        label = ", ".join(
            f"{short[one.key]} = {worded(row.values[one.key], one)}" for one in others
        )
        groups.setdefault(label, []).append(k)
    return groups


def _legend(figure: Figure, labels: Sequence[str], columns: int, *, bars: bool) -> None:
    """Above all panels: what the lines are of, and what bars are."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=_INK[n], marker="o", ms=4, label=literal(label))
        for n, label in enumerate(labels)
    ]
    if bars:
        bar = "estimated error of the mesh"
        handles.append(
            Line2D([], [], color=_GREY, ls="none", marker="|", ms=10, mew=0.9, label=bar)
        )
    if handles:
        figure.legend(handles=handles, loc="upper center", ncols=columns, frameon=False, fontsize=8)


def _panel(
    panel: Axes, results: Results, name: str, key: str, *, below: bool, beside: bool
) -> None:
    """A result over a setting, with the name of the one below and that of the other beside."""
    x, unit, words = _abscissae([row.values[key] for row in results.rows])
    known = [math.isfinite(row.numbers.get(name, math.nan)) for row in results.rows]
    x, rows = x[known], list(compress(results.rows, known))
    largest = max((abs(row.numbers[name]) for row in rows), default=0.0)
    factor, own = scaled_unit(largest, unit_of(name))
    scattered = bool(results.design.scatter)
    order_of = {label: n for n, label in enumerate(_groups(results, results.rows, key))}
    for label, members in _groups(results, rows, key).items():
        order = sorted(members, key=lambda k: float(x[k]))
        y = np.array([rows[k].numbers[name] for k in order]) / factor
        line = "none" if scattered or words else "-"
        ink = _INK[order_of[label] % len(_INK)]
        bars = np.array([rows[k].errors.get(name, math.nan) for k in order]) * np.abs(y)
        bars = np.nan_to_num(bars)
        if np.any(bars):
            panel.errorbar(x[order], y, bars, fmt="none", elinewidth=0.9, ecolor=ink, alpha=0.5)
        panel.plot(x[order], y, marker="o", ms=4, ls=line, lw=1.3, color=ink)
    if words:
        panel.set_xticks(range(len(words)), [literal(word) for word in words])
        panel.margins(x=0.15)
    else:
        panel.locator_params(axis="x", nbins=5)
    if below:
        panel.tick_params(labelbottom=True)
        panel.set_xlabel(literal(f"{key} [{unit}]" if unit else key))
    if beside:
        panel.set_ylabel(literal(f"{name} [{own}]" if own else name))
    panel.grid(color="#dde1e5", lw=0.7)
    panel.spines[["top", "right"]].set_visible(False)
    panel.spines[["left", "bottom"]].set_color(_GREY)
    panel.tick_params(color=_GREY)


def _abscissae(values: Sequence[object]) -> tuple[FloatArray, str, list[str]]:
    """Numbers, their unit, and words where they are none or have several units."""
    read = [number_and_unit(value) for value in values]
    units = {one[1] for one in read if one is not None}
    if values and None not in read and len(units) == 1:
        return np.array([one[0] for one in read if one is not None]), units.pop(), []
    words = list(dict.fromkeys(str(value) for value in values))
    return np.array([float(words.index(str(value))) for value in values]), "", words
