"""The numbers that were measured, as runs of a case have them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI

from dolfin_elastic.case.case import Case, locate_errors
from dolfin_elastic.case.check.rest import read_body
from dolfin_elastic.core.errors import CaseError, InputError, SolveError
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.core.si_text import number, quantity
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.problem.material_regions import formulation_of
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import State
from dolfin_elastic.solvers.statics.settings import Seconds, StaticsSettings
from dolfin_elastic.solvers.statics.statics import Statics
from dolfin_elastic.study.gradient.gradient import close_gaps, places_of_probes
from dolfin_elastic.study.identify.measured import (
    Measured,
    MeasuredCurve,
    MeasuredField,
    place_of,
)
from dolfin_elastic.study.identify.points import LocatedPoints, located_field
from dolfin_elastic.study.identify.tangents import Tangents, differentiable
from dolfin_elastic.study.identify.unknowns import Unknown
from dolfin_elastic.study.quiet import quietly
from dolfin_elastic.study.wanted import Wanted, WantedNumber

_WITH_STATES = ("statics", "dynamics")
_STEP = 1e-3
"""Of central differences, over the value: their error is its square, beside that of the solver over
it."""
_SMALLER, _TRIALS = 8.0, 3
_MOST_STOPS = 60
"""Load factors that a run meets because of one curve; between them it is interpolated."""
_FIRST_STOPS = 16
"""Of the run that finds where curves have their points."""
_EQUAL = 1e-9
"""Load parameters, over the end, that are one; changes of a number that are none."""
_REACH = 1e-6
"""Of the range of a curve by which its points may be beyond the run."""


@dataclass
class Record:
    """What one run has told.

    Attributes:
        t: Of its states: times [s], in statics load parameters.
        numbers: Name of a number to its values in these.
        fields: Of each displacement field the displacements in these, each of shape (n, dim).
        failure: Why the run is not to be relied on; empty where nothing is known against it.
        tangents: Derivatives of all of these by what is sought; None: not asked for, or not known.
    """

    t: list[float] = field(default_factory=list)
    numbers: dict[Wanted, list[float]] = field(default_factory=dict)
    fields: list[list[FloatArray]] = field(default_factory=list)
    failure: str = ""
    tangents: Tangents | None = None

    @property
    def last(self) -> FloatArray:
        """The numbers of the last state."""
        return np.array([values[-1] for values in self.numbers.values()])

    def of(self, curve: MeasuredCurve) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The curve of the run: t, x and y in its states, SI units, x growing.

        Raises:
            SolveError: x does not grow or fall all the way, or not to all points.
        """
        x = np.array(self.t if curve.x.is_time else self.numbers[curve.x.wanted]) * curve.x.factor
        y = np.array(self.numbers[curve.y.wanted]) * curve.y.factor
        kept = self._growing(x)
        if kept is None:
            raise SolveError(
                f"{curve.label}: {curve.x.text} does not grow all the time in this run",
                advice="a curve over t: a column t with load parameters or times",
            )
        order = kept[np.argsort(x[kept])]
        _check_reach(curve, x[order])
        return np.array(self.t)[order], x[order], y[order]

    def slopes_of(self, curve: MeasuredCurve) -> FloatArray:
        """Derivatives of the curve at its points by what is sought, shape (n, k).

        Of Y(x; m) they are dy/dm - dY/dx dx/dm, y and x being those of a state.
        """
        t, x, y = self.of(curve)
        assert self.tangents is not None
        order = np.searchsorted(self.t, t)
        columns, every = list(self.numbers), np.array(self.tangents.numbers)[order]
        by = every[:, columns.index(curve.y.wanted)] * curve.y.factor
        at = np.clip(curve.at, x[0], x[-1])
        result = _interpolated(x, by, at)
        if not curve.x.is_time:
            moved = _interpolated(x, every[:, columns.index(curve.x.wanted)] * curve.x.factor, at)
            result = result - _interpolated(x, y, at, slope=True)[:, None] * moved
        return result

    def _growing(self, x: FloatArray) -> IntArray | None:
        """States without those where x has hardly changed; None: it turns round."""
        least = _EQUAL * float(np.ptp(x))
        kept = np.append(np.flatnonzero(np.abs(np.diff(x)) > least), len(x) - 1)
        steps = np.diff(x[kept])
        return kept if len(kept) > 1 and ((steps > 0).all() or (steps < 0).all()) else None


class Runs:
    """Runs of a case with other values. Collective to make, and all of it.

    Args:
        case: With the values from which the search starts.
        unknowns: The k values that are sought, each with its dotted key.
        sets: What was measured; points of fields that are outside of the body are left out.
        petsc: PETSc options that win over the case's own.
        comm: The ranks that compute one run together.

    Attributes:
        sets: Without these points, and all points in metres.
        outside: A sentence about the points of each field that are left out.
        count: Runs so far.
        formulation: Of all runs, as that of the first; see `formulation_of`.

    Raises:
        InputError: The case has no run of states, or not what was measured.
    """

    def __init__(
        self,
        case: Case,
        unknowns: Sequence[Unknown],
        sets: Sequence[Measured],
        petsc: PetscOptions | None = None,
        comm: MPI.Comm = MPI.COMM_WORLD,
    ) -> None:
        self.case, self.unknowns, self._petsc, self._comm = case, unknowns, petsc, comm
        self._keys = [one.key for one in unknowns]
        part = self._analysis(case)
        self._body = read_body(part, comm)
        self._stops: tuple[float, ...] = ()
        self._direct = True
        self.formulation, self._held = "", dict[str, object]()
        self.outside: list[str] = []
        self.count, self.sets, self._points = 0, list[Measured](), list[LocatedPoints]()
        for one in sets:
            if isinstance(one, MeasuredField):
                inside, points, note = located_field(self._body, one)
                self.sets.append(inside)
                self._points.append(points)
                self.outside += [note] if note else []
            else:
                self.sets.append(one)
        self._curves = [one for one in self.sets if isinstance(one, MeasuredCurve)]
        self._wanted = {
            number.wanted: None
            for curve in self._curves
            for number in (curve.x, curve.y)
            if not number.is_time
        }
        probes, supports = [*part.output.probes], [support.label for support in part.support]
        for wanted in self._wanted:
            wanted.check(self._body, probes, supports)

    def _analysis(self, case: Case) -> Case:
        """The analysis that has states."""
        found = case.first_of(*_WITH_STATES)
        if found.analysis not in _WITH_STATES:
            raise CaseError(
                "modes alone have no curves and no displacements to compare",
                where=case.file,
                expected="a case with [statics] or [dynamics]",
            )
        return found

    # --- one run ---

    def changed(self, values: FloatArray, held: Mapping[str, object] | None = None) -> Case:
        """The case with values of what is sought, in the units in which it has them.

        Args:
            values: Of what is sought, shape (k,).
            held: Dotted keys to further values, the same in all runs.

        Raises:
            InputError: It cannot have them.
        """
        pairs = zip(self.unknowns, values, strict=True)
        sought = {one.key: one.written(float(v)) for one, v in pairs}
        return self.case.changed({**(held or {}), **sought})

    def record(
        self, values: FloatArray, stops: Sequence[float] = (), *, slopes: bool = False
    ) -> Record:
        """One run.

        Args:
            values: Of what is sought, shape (k,).
            stops: Load parameters that the run must meet, beside those of the case.
            slopes: Also derivatives, where they are known without differences.

        Raises:
            InputError: The case cannot have these values.
            SolveError: No solution was found.
        """
        self.count += 1
        case = self.changed(values, self._held)
        if stops:
            case = case.changed({"statics.times": self._times(stops)})
        case = self._analysis(case)
        with locate_errors(case.file):
            problem = case.make_problem(self._body)
            if not self._held:  # beyond nu = 0.45 there would be a pressure, and a jump
                self._held = {"mesh.formulation": "mixed" if problem.mixed else "displacement"}
                self.formulation = formulation_of(problem.regions)
            solver = case.make_solver(problem, petsc=self._petsc)
            known = isinstance(solver, Statics) and differentiable(problem, self._keys)
            if known:  # of all runs alike, whether their derivatives are asked for or not
                close_gaps(problem)
            probe = case.output.make_probe(problem)
            numbers = {wanted: WantedNumber(wanted, problem) for wanted in self._wanted}
            result = Record(numbers={w: [] for w in numbers}, fields=[[] for _ in self._points])
            if slopes and known:
                assert isinstance(solver, Statics)
                result.tangents = solver.observer = self._tangents(case, problem)
            with closing(solver.steps()) as states:
                for state in states:
                    if isinstance(state, State) and not state.between:
                        told = probe.add_to(state)
                        result.t.append(told.t)
                        for wanted, number in numbers.items():
                            result.numbers[wanted].append(number(told)[0].value)
                        for points, row in zip(self._points, result.fields, strict=True):
                            row.append(points.displacements(told.u))
                        result.failure = told.failure
        return result

    def jump(self, values: FloatArray) -> str:
        """What to know where the case with the values found has another formulation; else empty.

        Args:
            values: Of what is sought, as they were found, shape (k,).
        """
        with quietly():
            problem = self._analysis(self.changed(values)).make_problem(self._body)
        if (own := formulation_of(problem.regions)) == self.formulation:
            return ""
        return (
            f"all runs have the formulation of the first, {self.formulation}; the case with the "
            f"values found has {own}, and results jump there by the error of the mesh: "
            "fit the fitted case once more, or choose mesh.formulation"
        )

    def _tangents(self, case: Case, problem: Problem) -> Tangents | None:
        """Derivatives without differences; None: there are none."""
        wanted, places = list(self._wanted), places_of_probes(case, self._body)
        try:
            made = Tangents(case, problem, self._keys, wanted, self._points, places)
        except InputError:  # a number has none
            return None
        return None if made.smoothed else made

    def _settings(self) -> StaticsSettings:
        return self._analysis(self.case).statics or StaticsSettings()

    def _times(self, stops: Sequence[float]) -> list[object]:
        """Those of the case and others, as it takes them."""
        settings = self._settings()
        end, result = float(settings.end), list[float]()
        for t in sorted([*map(float, settings.times), *stops]):
            if _EQUAL * end < t and (not result or t - result[-1] > _EQUAL * end):
                result.append(min(t, end))
        timed = isinstance(settings.end, Seconds)
        return [f"{t!r} s" for t in result] if timed else [*result]

    def plan(self, values: FloatArray) -> None:
        """Chooses the load parameters that all runs meet: where the measured points are.

        Args:
            values: Of what is sought, from which the search starts, shape (k,).

        Raises:
            InputError: The run has not what was measured.
            SolveError: It has no solution, or does not come to all points.
        """
        part, settings = self._analysis(self.case), self._settings()
        statics = part.analysis == "statics"
        end = float(settings.end if statics or part.dynamics is None else part.dynamics.end)
        if settings.method == "load" or not statics:
            for one in self.sets:
                _check_times(one, end, f"{part.analysis}.end")
        if not statics or settings.method != "load":
            return
        stops = [
            float(t)
            for one in self.sets
            for t in _few(one.times if isinstance(one, MeasuredField) else _of_time(one))
        ]
        others = [curve for curve in self._curves if not curve.x.is_time]
        if others:
            even = [float(t) for t in np.linspace(0.0, end, _FIRST_STOPS + 1)[1:]]
            found = self.record(values, [*stops, *even])
            for curve in others:
                t, x, _ = found.of(curve)
                stops += [float(one) for one in _few(np.interp(curve.at, x, t))]
        self._stops = tuple(min(one, end) for one in stops)

    # --- all numbers ---

    def numbers(self, values: FloatArray) -> FloatArray:
        """All that was measured as a run has it, SI units, shape (N,).

        Raises:
            InputError: The case cannot have these values.
            SolveError: No solution was found, or it does not come to all points.
        """
        parts = self.by_set(self.compared(values))
        return np.concatenate([part.ravel() for part in parts])

    def compared(self, values: FloatArray) -> Record:
        """The run with the load parameters of the search."""
        return self.record(values, self._stops)

    def by_set(self, record: Record) -> list[FloatArray]:
        """What was measured as a run has it, set by set in the shape of its values."""
        result, number = list[FloatArray](), 0
        for one in self.sets:
            if isinstance(one, MeasuredCurve):
                _, x, y = record.of(one)
                result.append(_interpolated(x, y, np.clip(one.at, x[0], x[-1])))
            else:
                rows = np.array(record.fields[number])[:, :, list(one.components)]
                result.append(_at_times(np.array(record.t), rows, one.times))
                number += 1
        return result

    def jacobian(
        self, values: FloatArray, sizes: FloatArray, low: FloatArray, high: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """All numbers, and their derivatives, where they are not known by differences of runs.

        A run that fails is tried again nearer; one side is enough.

        Args:
            values: Of what is sought, shape (k,).
            sizes: Their scales, shape (k,).
            low: Least values, shape (k,).
            high: Largest values, shape (k,).

        Returns:
            Shapes (N,) and (N, k), in SI units over the units of the values.

        Raises:
            SolveError: No run nearby has a solution.
        """
        try:
            record = self.record(values, self._stops, slopes=self._direct)
        except InputError:  # of a linear solution that was not found, or of the values
            record = self.record(values, self._stops)
        base = np.concatenate([part.ravel() for part in self.by_set(record)])
        known = record.tangents
        self._direct = known is not None and known.agree(record.last)
        if self._direct:
            return base, self._slopes(record)
        slopes = np.empty((len(base), len(values)))
        for i in range(len(values)):
            step = _STEP * max(abs(values[i]), 0.1 * sizes[i])
            slopes[:, i] = self._slope(values, base, i, step, (low[i], high[i]))
        return base, slopes

    def _slopes(self, record: Record) -> FloatArray:
        """Derivatives without differences, shape (N, k)."""
        assert record.tangents is not None
        result, number = list[FloatArray](), 0
        for one in self.sets:
            if isinstance(one, MeasuredCurve):
                result.append(record.slopes_of(one))
            else:
                rows = np.array([state[number] for state in record.tangents.fields])
                rows = rows[:, :, list(one.components)]
                found = _at_times(np.array(record.t), rows, one.times)
                result.append(found.reshape(-1, found.shape[-1]))
                number += 1
        return np.vstack(result)

    def _slope(
        self,
        values: FloatArray,
        base: FloatArray,
        i: int,
        step: float,
        ends: tuple[float, float],
    ) -> FloatArray:
        for _ in range(_TRIALS):
            found = [(values[i], base)]
            for side in (-step, step):
                trial = values.copy()
                trial[i] = np.clip(values[i] + side, *ends)
                if trial[i] != values[i]:
                    try:
                        found.append((trial[i], self.numbers(trial)))
                    except (InputError, SolveError):
                        continue
            if len(found) > 1:
                (a, first), (b, last) = found[-2:]
                return np.asarray((last - first) / (b - a))
            step /= _SMALLER
        raise SolveError(
            f"no run with {self.unknowns[i].key} near {values[i]:.6g} has a solution",
            advice="other starting values, or --bounds",
        )


def _few(times: FloatArray) -> FloatArray:
    """Some of many times, evenly."""
    times = np.unique(times[np.isfinite(times)])
    if len(times) <= _MOST_STOPS:
        return times
    return times[np.round(np.linspace(0, len(times) - 1, _MOST_STOPS)).astype(int)]


def _of_time(curve: MeasuredCurve) -> FloatArray:
    return curve.at * 1.0 if curve.x.is_time else np.empty(0)


def _check_times(one: Measured, end: float, key: str) -> None:
    """Refuses what was measured when no run is.

    Args:
        end: Load factor or time [s] at which the run ends.
        key: Dotted key of it in the case.
    """
    times = one.times if isinstance(one, MeasuredField) else _of_time(one)
    bad = np.flatnonzero((times > end * (1 + _REACH)) | (times < 0))
    if len(bad):
        where, line = place_of(one, int(bad[0]))
        t = float(times[bad[0]])
        beyond = "beyond the end of the run" if t > 0 else "before the run"
        raise CaseError(
            f"{line}something was measured at t = {t:g}, {beyond}",
            where=where,
            expected=f"from 0 to {key} = {end:g}",
        )


def _check_reach(curve: MeasuredCurve, x: FloatArray) -> None:
    """Refuses a run that does not come to all points of a curve."""
    room = _REACH * float(x[-1] - x[0])
    for row in (int(curve.at.argmin()), int(curve.at.argmax())):
        far = float(curve.at[row])
        if not x[0] - room <= far <= x[-1] + room:
            where, line = place_of(curve, row)
            low, high, at = (_with_unit(value, curve.x.unit) for value in (x[0], x[-1], far))
            raise SolveError(
                f"{where}: {line}measured at {at}, but {curve.x.text} runs from {low} to {high}",
                advice="more load in the case; or a curve over what the case prescribes",
            )


def _with_unit(value: float, unit: str) -> str:
    return quantity(value, unit) if unit else number(value)


def _interpolated(
    x: FloatArray, y: FloatArray, at: FloatArray, *, slope: bool = False
) -> FloatArray:
    """Between states without overshooting, exact at them; or its slope there.

    Args:
        y: In the states, shape (s,) or (s, k).

    Source: F. N. Fritsch and R. E. Carlson, SIAM J. Numer. Anal. 17 (1980) 238.
    """
    from scipy.interpolate import PchipInterpolator

    return np.asarray(PchipInterpolator(x, y)(at, int(slope)))


def _at_times(t: FloatArray, rows: FloatArray, times: FloatArray) -> FloatArray:
    """Displacements at their times, linear between states, shape (n, c).

    Args:
        t: Of the states, shape (s,).
        rows: In all states, shape (s, n, c) or (s, n, c, k).
        times: Of the points, nan for the end, shape (n,).
    """
    times = np.where(np.isnan(times), t[-1], times)
    after = np.clip(np.searchsorted(t, times), 1, len(t) - 1)
    part = np.clip((times - t[after - 1]) / (t[after] - t[after - 1]), 0.0, 1.0)
    part = part.reshape(-1, *[1] * (rows.ndim - 2))
    each = np.arange(len(times))
    return np.asarray((1 - part) * rows[after - 1, each] + part * rows[after, each])
