"""What a report says of a finished run, section by section."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dolfin_elastic.core.si_text import number, percent, quantity, scaled_unit
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.report.charts import Axis, Line, line_chart
from dolfin_elastic.report.words import analysis_of
from dolfin_elastic.results.finished.findings import Value
from dolfin_elastic.results.finished.run import FinishedRun
from dolfin_elastic.results.verdict import Table

_ROUND_OFF = 1e-8
"""Values over the largest of their unit that are not worth a curve."""
_FEW = 3
"""Residuals of so few iterations fall to round-off at once, and make no curve."""
_ROWS = 60
"""Steps that the table shows: the first and the last ones."""
_AXES = ("x", "y", "z")


def diagnosis_lines(summary: Table) -> list[str]:
    """What is known of why a run has failed: each finding in a line."""
    diagnosis, reason = summary.get("diagnosis") or {}, str(summary.get("reason") or "")
    texts = [str(diagnosis.get(key) or "") for key in ("text", "advice")]
    return [text for text in texts if text and text not in reason]


LastValue = tuple[str, tuple[tuple[str, Value], ...]]
"""Name of a probe, moment or other column of the history, and its components (empty of a scalar)
with their values in the last state."""
_OTHERWISE = ("reaction_", "momentum_", "angular_momentum_", "balance_")
"""Beginnings of columns that other sections show."""


def last_values(run: FinishedRun) -> list[LastValue]:
    """Probes, moments and all other columns of the history that no other section shows."""
    history = run.history
    if not run.summary.get("steps") or not len(history.get("step", ())):
        return []
    names = [
        name
        for name in history
        if not name.startswith(_OTHERWISE) and not name.endswith("_energy") and name not in _TITLES
    ]
    probes = (run.case.get("output") or {}).get("probes") or {}
    result: list[LastValue] = []
    for title, columns in _groups(names):
        what = ": displacement" if columns[0].rpartition("_")[0] in probes else ""
        numbers = [float(history[name][-1]) for name in columns]
        most = max((abs(x) for x in numbers if math.isfinite(x)), default=0.0)
        factor, unit = scaled_unit(most, run.units.get(columns[0], ""))
        rows = []
        for name, x in zip(columns, numbers, strict=True):
            text = "0" if abs(x) <= 1e-9 * most else number(x / factor)
            last = name.rpartition("_")[2]  # with one column the title says all but an axis
            axis = last if last in _AXES or len(columns) > 1 else ""
            rows.append((axis, Value(x, f"{text} {unit}" if unit and math.isfinite(x) else text)))
        result.append((title + what, tuple(rows)))
    return result


# --- history ---


Chart = tuple[str, str]
"""Title and SVG of a picture."""
_TITLES = {
    "max_displacement": "Largest displacement",
    "newton": "Newton iterations",
    "balance_force": "What is left of the balance of forces",
}
_NOT_DRAWN = (
    "step",
    "t",
    "load_factor",
    "krylov",
    "newton",
    "balance_force",
    "balance_moment",
    "external_work",
    "min_jacobian",
    "max_jacobian",
)


def history_charts(run: FinishedRun) -> list[Chart]:
    """Curves of `history.csv`; none of fewer than three rows."""
    history = run.history
    if len(history.get("t", ())) < 3:
        return []
    across, axis = _time_axis(run)
    result: list[Chart] = []
    for title, columns in _groups(list(history)):
        drawn = [name for name in columns if _worth(run, name)]
        if drawn:
            result.append((title, _chart(run, title, drawn, across, axis)))
    return result


def _time_axis(run: FinishedRun) -> tuple[FloatArray, Axis]:
    if run.timed:
        factor, unit = scaled_unit(float(np.nanmax(run.history["t"])), "s")
        return np.asarray(run.history["t"] / factor), Axis(f"time [{unit}]")
    # Beyond a limit point the load falls: steps are the only axis along which a path goes forward.
    load = run.history.get("load_factor", run.history["t"])
    if (np.diff(load) < 0).any():
        return run.history["step"], Axis("step", whole=True)
    return load, Axis("load factor")


def _groups(columns: Sequence[str]) -> list[tuple[str, list[str]]]:
    """Columns that share a picture, with its title."""
    result: dict[str, list[str]] = {}
    for name in columns:
        if name in _NOT_DRAWN:
            continue
        stem, _, last = name.rpartition("_")
        stem = stem if stem and last in _AXES else name
        if name in _TITLES:
            title = _TITLES[name]
        elif name.endswith("_energy"):
            title = "Energies"
        elif stem != name and stem.startswith("reaction_"):
            title = f"Reaction of {stem.removeprefix('reaction_')}"
        else:
            title = stem[:1].upper() + stem[1:].replace("_", " ")
        result.setdefault(title, []).append(name)
    return list(result.items())


def _worth(run: FinishedRun, name: str) -> bool:
    """Whether a column is more than zeros and round-off, beside the others of its unit."""
    unit, finite = run.units.get(name), run.history[name][np.isfinite(run.history[name])]
    alike = [run.history[one] for one in run.history if unit and run.units.get(one) == unit]
    scale = max((float(np.abs(v[np.isfinite(v)]).max(initial=0.0)) for v in alike), default=0.0)
    return len(finite) > 1 and float(np.abs(finite).max()) > _ROUND_OFF * scale


def _chart(run: FinishedRun, title: str, columns: list[str], x: FloatArray, axis: Axis) -> str:
    unit = run.units.get(columns[0], "")
    most = max(float(np.nanmax(np.abs(run.history[name]))) for name in columns)
    factor, shown = scaled_unit(most, unit)
    lines = [
        Line(_line_name(name, len(columns)), x, np.asarray(run.history[name] / factor))
        for name in columns[:8]
    ]
    up = Axis(f"[{shown}]" if shown else "")
    return line_chart(lines, axis, up, title=title)


def _line_name(column: str, count: int) -> str:
    if column.endswith("_energy"):
        return column.removesuffix("_energy")
    last = column.rpartition("_")[2]
    return last if last in _AXES else "" if count == 1 else column


# --- convergence ---


def newton_chart(run: FinishedRun) -> Chart | None:
    """Newton iterations of each step; None where there are none."""
    counts, steps = run.history.get("newton"), run.history.get("step")
    if counts is None or steps is None or len(steps) < 3 or not _worth(run, "newton"):
        return None
    line = Line("", steps[1:], counts[1:])
    x, y = Axis("step", whole=True), Axis("iterations", whole=True)
    return "Newton iterations of each step", line_chart([line], x, y, "Newton iterations")


def residual_chart(summary: Table) -> Chart | None:
    """Residuals over Newton iterations, of the steps whose residuals the run has kept."""
    lines = []
    for name, row in (summary.get("convergence") or {}).items():
        values = np.array([float(x) for x in row.get("residuals") or [] if x is not None])
        if len(values) > _FEW and (values > 0).any():
            text = f"step {row.get('step')} ({str(name).replace('_', ' ')})"
            lines.append(Line(text, np.arange(len(values), dtype=float), values))
    if not lines:
        return None
    if len(lines) > 1 and np.array_equal(lines[0].y, lines[1].y):
        lines = lines[1:]
    x, y = Axis("Newton iteration", whole=True), Axis("residual [N]", logarithmic=True)
    return "Residual of Newton's method", line_chart(lines, x, y, "Residuals")


@dataclass(frozen=True)
class Steps:
    """Rows of the table of steps.

    Attributes:
        heads: Of the columns.
        rows: Texts.
        left_out: Steps between the first and the last that are not shown.
    """

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left_out: int


def steps_of(run: FinishedRun) -> Steps | None:
    """The table of steps; None without a history."""
    history = run.history
    if not len(history.get("step", ())):
        return None
    wanted = [
        ("step", "step", ""),
        ("t", "time", "s") if run.timed else ("load_factor", "load factor", ""),
        ("newton", "Newton iterations", ""),
        ("krylov", "linear iterations", ""),
        ("max_displacement", "largest displacement", "m"),
        ("balance_force", "force left", ""),
        ("min_jacobian", "smallest volume ratio", ""),
    ]
    columns = [
        (title, unit, history[name])
        for name, title, unit in wanted
        if name in history and (name != "krylov" or _worth(run, name))
    ]
    count, first = len(history["step"]), _ROWS // 3
    kept = [k for k in range(count) if k < first or k >= count - (_ROWS - first)]
    rows = tuple(
        tuple(quantity(float(values[k]), unit) for _, unit, values in columns) for k in kept
    )
    return Steps(tuple(title for title, _, _ in columns), rows, count - len(kept))


# --- audit ---


@dataclass(frozen=True)
class Checked:
    """The audit in words.

    Attributes:
        verdict: For people.
        kind: "good", "warn" or "bad".
        lines: What was checked, with figures.
        reasons: What speaks against the run.
        notes: What cannot be judged.
        error: Estimated error of the whole stress field; None: not estimated.
    """

    verdict: str
    kind: str
    lines: tuple[str, ...]
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
    error: Value | None


_VERDICTS = {
    "pass": (
        "Passed: forces, moments and energy balance, and no element is turned inside out",
        "good",
    ),
    "warn": ("Passed with doubts", "warn"),
    "fail": ("Failed: not to be relied on", "bad"),
}


def audit_of(run: FinishedRun) -> Checked:
    """What the run has checked of itself, and what it cannot."""
    summary = run.summary
    # The state before the first step passes every check, and says nothing.
    audit = (summary.get("audit") or {}) if summary.get("steps") else {}
    verdict, kind = _VERDICTS.get(str(audit.get("verdict")), ("Nothing was audited", "warn"))
    known = (summary.get("error") or {}).get("energy_norm") if audit else None
    error = Value(float(known), percent(known)) if isinstance(known, int | float) else None
    return Checked(
        verdict,
        kind,
        tuple(_audit_lines(audit, summary)),
        tuple(str(text) for text in audit.get("reasons") or []),
        (
            *(str(text) for text in audit.get("notes") or []),
            *_reservations(summary),
            *_not_judged(run, error),
        ),
        error,
    )


def _audit_lines(audit: Table, summary: Table) -> Iterator[str]:
    for key, what in (("balance_force", "forces"), ("balance_moment", "moments")):
        if isinstance(audit.get(key), int | float):
            yield f"Of all {what} together {number(float(audit[key]), 2)} is left (0 is balance)."
    work, stored = audit.get("external_work"), audit.get("stored_energy")
    if isinstance(work, int | float) and isinstance(stored, int | float):
        yield (
            "Work of all forces on the body, those of springs and contact among them: "
            f"{quantity(work, 'J')}{_rubbed(summary)}; energy in the body: "
            f"{quantity(stored, 'J')}."
        )
    yield from _damping_lines(summary)
    for key, what in (("min_jacobian", "most compressed"), ("max_jacobian", "most expanded")):
        row = audit.get(key)
        if isinstance(row, Mapping) and isinstance(row.get("value"), int | float):
            yield f"The {what} material has {number(float(row['value']))} of its volume."
    if text := _stability(summary.get("stability")):
        yield text
    limits = [x for x in summary.get("limit_points") or [] if isinstance(x, int | float)]
    if limits:
        yield f"Limit points were passed at the load factors {', '.join(map(number, limits))}."


def _rubbed(summary: Table) -> str:
    """What friction has taken of the work of the other forces."""
    numbers = summary.get("numbers")
    rows = numbers.items() if isinstance(numbers, Mapping) else ()
    lost = sum(
        float(value)
        for key, value in rows
        if key.startswith("friction_dissipation_") and isinstance(value, int | float)
    )
    return f", after friction has taken {quantity(lost, 'J')}" if lost > 0.0 else ""


def _damping_lines(summary: Table) -> Iterator[str]:
    """What damping has dissipated in a motion, and which mass was added for its step."""
    energies, numbers = summary.get("energies"), summary.get("numbers")
    lost = energies.get("damping") if isinstance(energies, Mapping) else None
    if isinstance(energies, Mapping) and isinstance(lost, int | float) and lost > 0:
        bulk = energies.get("bulk_viscosity")
        of = ""
        if isinstance(bulk, int | float) and bulk > 0:
            of = f", {quantity(bulk, 'J')} of it bulk viscosity"
        yield f"Damping has dissipated {quantity(lost, 'J')}{of}."
    added = numbers.get("added_mass_fraction") if isinstance(numbers, Mapping) else None
    if isinstance(added, int | float):
        yield f"Mass scaling has added {percent(added)} of the mass: inertia without weight."


def _reservations(summary: Table) -> Iterator[str]:
    """What limits how far the largest stresses can be believed."""
    error = summary.get("error")
    notes = error.get("reservations") if isinstance(error, Mapping) else None
    for text in notes if isinstance(notes, list) else []:
        if not str(text).startswith("not to be relied on: at"):  # the table of results has it
            yield f"Largest stress: {text}."


def _stability(stability: object) -> str:
    """Of the last state; empty where it was not judged, which is among the reasons."""
    if not isinstance(stability, Mapping) or not isinstance(
        stability.get("negative_eigenvalues"), int
    ):
        return ""
    why = str(stability.get("reason") or "no small motion lowers its energy")
    if "know no buckling" in why:
        return f"Whether the part buckles was not looked at: {why}."
    if stability.get("verdict") == "stable":
        return f"The last equilibrium is stable: {why}."
    least = "at least " if stability.get("at_least") else ""
    return (
        "The last equilibrium is unstable, a real body would leave it: its tangent has "
        f"{least}{stability['negative_eigenvalues']} negative eigenvalue(s)."
    )


def _not_judged(run: FinishedRun, error: Value | None) -> Iterator[str]:
    yield (
        "No computation knows whether material constants, loads and supports are those of the real "
        "body: that is for the reader to judge, from the sections below."
    )
    kind = analysis_of(run.case)
    if kind in ("modal", "buckling"):
        what = "modes" if kind == "modal" else "buckling loads"
        yield f"The error by the size of the elements is not estimated for {what}."
    elif run.moving:
        yield "The error by the size of the elements and of the time steps is not estimated."
    elif error is None and run.summary.get("status") == "completed":
        yield "The error by the size of the elements was not estimated."
