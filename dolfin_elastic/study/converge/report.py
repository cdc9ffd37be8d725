"""The files of `converge`: `converge.csv`, `converge.json` and `converge.png`."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from dolfin_elastic.core.si_text import literal
from dolfin_elastic.core.startup.elsewhere import plain_matplotlib
from dolfin_elastic.results.files import drafted, make_folder, replace_text
from dolfin_elastic.study.wanted import Wanted

Verdict = Literal["running", "reached", "singular", "audit", "refinements", "unknowns", "stopped"]


@dataclass(frozen=True)
class Level:
    """The results of one mesh.

    Attributes:
        number: 1, 2, ...
        cells: Of the mesh, on all ranks.
        unknowns: Of the problem.
        value: The quantity, in its SI unit.
        error: Its estimated relative error; of the first mesh that of the recovered stress, nan of
            other quantities.
        limit: Its extrapolated value; nan where there is none.
        rate: Observed s of an error that falls like N^-s; nan where it is not known.
        energy_error: Estimated relative error in the energy norm.
        place: Where a field has its largest value [m]; empty for other quantities.
        size: About the edge length of the cells there [m].
        newton: Newton iterations.
    """

    number: int
    cells: int
    unknowns: int
    value: float
    error: float
    limit: float
    rate: float
    energy_error: float
    place: tuple[float, ...]
    size: float
    newton: int


@dataclass(frozen=True)
class Progress:
    """All meshes so far, and whether the goal is reached.

    Attributes:
        quantity: What is wanted.
        tolerance: Relative error at which it counts as known.
        levels: Of each mesh.
        verdict: "running"; "reached"; "singular", the quantity has no limit; "audit", that of a
            solution fails; the limit that ended it, "refinements" or "unknowns"; or "stopped".
        reason: Why it ended without reaching the goal, in words; empty otherwise.
    """

    quantity: Wanted
    tolerance: float
    levels: tuple[Level, ...]
    verdict: Verdict = "running"
    reason: str = ""

    @property
    def last(self) -> Level:
        """The results of the finest mesh."""
        return self.levels[-1]

    @property
    def head(self) -> str:
        """The quantity with its unit."""
        unit = self.quantity.unit
        return f"{self.quantity} [{unit}]" if unit else str(self.quantity)


TABLE, SUMMARY, PLOT = FILES = ("converge.csv", "converge.json", "converge.png")
_INK, _LIMIT, _ENERGY = "#1f5f8b", "#b0562f", "#228833"


def write_report(progress: Progress, folder: Path, *, plot: bool = True) -> None:
    """Writes all three files anew. Not collective.

    Args:
        progress: All meshes so far.
        folder: Of the results; made if missing.
        plot: Without, the plot stays as it is, for drawing takes time.

    Raises:
        OutputError: They cannot be written.
    """
    make_folder(folder)
    replace_text(folder / TABLE, _table(progress))
    replace_text(folder / SUMMARY, json.dumps(_summary(progress), indent=2, allow_nan=False) + "\n")
    if plot:
        _draw(progress, folder / PLOT)


def _table(progress: Progress) -> str:
    """One row a mesh, in SI units; nothing where a number is not known."""
    rows = [_row(level) for level in progress.levels]
    lines = [",".join(rows[0])]
    lines += [",".join("" if v is None else f"{v:.12g}" for v in row.values()) for row in rows]
    return "\n".join(lines) + "\n"


def _row(level: Level) -> dict[str, float | None]:
    values = asdict(level)
    place = values.pop("place")
    values |= {f"place_{axis}": x for axis, x in zip("xyz", place, strict=False)}
    return {name: v if math.isfinite(v) else None for name, v in values.items()}


def _summary(progress: Progress) -> dict[str, object]:
    last = _row(progress.last)
    return {
        "verdict": progress.verdict,
        "reason": progress.reason,
        "quantity": str(progress.quantity),
        "unit": progress.quantity.unit,
        "tolerance": progress.tolerance,
        **{name: last[name] for name in ("value", "error", "limit", "rate", "energy_error")},
        "place": list(progress.last.place),
        "meshes": [_row(level) for level in progress.levels],
    }


@plain_matplotlib()
def _draw(progress: Progress, path: Path) -> None:
    """The quantity and the errors over the unknowns."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    N = [level.unknowns for level in progress.levels]
    values = np.array([level.value for level in progress.levels])
    left.plot(N, values, "o-", color=_INK, label="on the mesh")
    limit = progress.last.limit
    if math.isfinite(limit):
        left.axhline(limit, ls="--", color=_LIMIT, label=f"extrapolated: {limit:.4g}")
        band = progress.tolerance * abs(limit)
        left.axhspan(limit - band, limit + band, color=_LIMIT, alpha=0.12, lw=0)
    left.set(xscale="log", xlabel="unknowns", title=literal(progress.head))
    errors = [100 * level.error for level in progress.levels]
    energy = [100 * level.energy_error for level in progress.levels]
    right.loglog(N, errors, "o-", color=_INK, label=literal(str(progress.quantity)))
    right.loglog(N, energy, "s:", color=_ENERGY, label="in the energy norm")
    right.axhline(100 * progress.tolerance, ls="--", color=_LIMIT, label="wanted")
    right.set(xlabel="unknowns", title="estimated error [%]")
    for axis in (left, right):
        axis.grid(color="#dde1e5")
        axis.legend(fontsize=8)
    with drafted(path) as draft:
        figure.savefig(draft, dpi=130, format=path.suffix[1:])
