"""`identify_field`: a constant of a material in every cell, from measured displacements.

What is made least, by m = ln E in the cells of the material, is

    sum w (u - u_measured)^2/(n s^2) + a R(m),

with a penalty R of the jumps between cells (`Jumps`) and its weight a: a measured field alone does
not tell as many values as there are cells.  Where the scatter of the measurement is given, a falls
until the differences are as large as that, V. A. Morozov's discrepancy principle (Soviet Math.
Dokl. 7 (1966) 414).  Derivatives are those of one adjoint solution; the search is the
limited-memory BFGS method of TAO, with the volumes of the cells as its inner product.

Source: A. A. Oberai, N. H. Gokhale and G. R. Feijoo, Inverse Problems 19 (2003) 297 (the adjoint of
elasticity imaging); J. Nocedal and S. J. Wright, Numerical Optimization (2006), section 7.2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.case.case import Case, locate_errors
from dolfin_elastic.case.check.rest import read_body
from dolfin_elastic.core.errors import CaseError, InputError, SolveError
from dolfin_elastic.core.parallel import on_root, total
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.core.si_text import percent, quantity
from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.state import State
from dolfin_elastic.solvers.nonlinear.adjoint import Adjoint
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.statics.statics import Statics
from dolfin_elastic.study.gradient.parameters import Equilibrium
from dolfin_elastic.study.gradient.spatial import CellConstant
from dolfin_elastic.study.identify.identify import ComparedSet
from dolfin_elastic.study.identify.jumps import Jumps, Penalty, penalty_of
from dolfin_elastic.study.identify.measured import Measured, MeasuredField, as_measured
from dolfin_elastic.study.identify.misfit import PointMisfit
from dolfin_elastic.study.identify.points import LocatedPoints, located_field
from dolfin_elastic.study.identify.unknowns import constant_at

ITERATIONS = 150
"""Of the search for one weight."""
_FIRST, _LESS, _STAGES = 0.02, 4.0, 12
"""First weight, over the misfit of a uniform body; what it is divided by; and how often at most."""
_ENOUGH = 1.1
"""Differences over the scatter of the measurement that are as small as they should be."""
_FLAT, _FLAT_ON_THE_WAY, _ON_THE_WAY = 1e-5, 0.05, 40
"""Slope, over that at the start, that is none; the same for one of many weights, and iterations."""
_WALL = 2.0
"""Value of a field without a solution, over the best one."""
_NO_STEP, _COUNT = -6, -2
"""TAO's reasons for ends."""
_LOST = "beyond the best field there is no solution"


@dataclass(frozen=True)
class FieldFound:
    """A constant of a material in every cell.

    Attributes:
        case: The one in whose place of a number the field is.
        key: Dotted key of the constant.
        problem: With the field.
        state: Its end.
        values: In owned cells [SI], shape (cells,).
        chosen: Owned cells of the material, shape (cells,).
        sets: What was measured beside the case.
        seen: The constant at the points of each of these [SI], nan in other materials.
        weight: Of the penalty.
        penalty: Its kind and value.
        ended: The search has come to its end.
        why: How it has ended.
        runs: Runs that it has taken.
        notes: Remarks.
    """

    case: Case
    key: str
    problem: Problem
    state: State
    values: FloatArray
    chosen: BoolArray
    sets: tuple[ComparedSet, ...]
    seen: tuple[FloatArray, ...]
    weight: float
    penalty: tuple[Penalty, float]
    ended: bool
    why: str
    runs: int
    notes: tuple[str, ...]

    @property
    def unit(self) -> str:
        """SI unit of the constant."""
        row = constant_at(self.case, self.key)
        return "" if row is None else row.unit

    @property
    def rms(self) -> float:
        """Root mean square of all differences [m]."""
        return _rms([one.computed - one.measured.values for one in self.sets])


def identify_field(
    case: Case,
    data: object,
    key: str,
    *,
    noise: float | None = None,
    weight: float | None = None,
    penalty: str = "tv",
    bounds: tuple[float, float] = (0.0, np.inf),
    weights: Mapping[str, float] | None = None,
    iterations: int = ITERATIONS,
    petsc: PetscOptions | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    told: Callable[[str], None] = lambda _: None,
) -> FieldFound:
    """Finds a constant of a material as a field with a value in each cell.  Collective.

        found = identify_field(read_case("gel.toml"), "dic.csv", "materials.gel.E", noise=2e-6)
        found.values        # E of the cells of this rank [Pa]

    Displacements alone tell ratios of moduli; their size follows from forces that the case
    prescribes, and without any from the mean of the case's own value.

    Args:
        case: From `read_case`, or made in Python; its constant is where the search starts.
        data: Displacement fields at the end of the load, as `identify` takes them.
        key: Such as "materials.gel.E", a positive number.
        noise: Standard deviation of the measured displacements [m], from which the weight follows.
        weight: Of the penalty; one of the two is needed.
        penalty: "tv" allows edges, "tikhonov" smooths.
        bounds: Least and largest value [SI].
        weights: See `identify`, as for `petsc`, `comm` and `told`.
        iterations: Of the search for one weight at most.

    Raises:
        InputError: Something that was given is wrong.
        SolveError: The case has no solution with its own value.
    """
    _check(noise, weight)
    measured = on_root(comm, lambda: as_measured(data, (), weights))
    search = _Search(case, key, measured, penalty_of(penalty), bounds, petsc, comm, told)
    return search.run(noise or 0.0, weight, iterations)


def _check(noise: float | None, weight: float | None) -> None:
    if (noise is None) == (weight is None):
        raise CaseError(
            "the weight of the penalty follows from the scatter of the measurement, or is given",
            expected="one of --noise and --smooth",
        )
    for option, number in (("--noise", noise), ("--smooth", weight)):
        if number is not None and not (np.isfinite(number) and number > 0):
            raise CaseError(f"{number:g} is wrong", where=option, expected="a number above 0")


def _rms(off: list[FloatArray]) -> float:
    every = np.concatenate([one.ravel() for one in off])
    return float(np.sqrt(np.mean(every**2)))


@dataclass
class _Point:
    """What one run has told: misfit, its slopes by ln E of owned cells, and differences."""

    value: float
    slopes: FloatArray
    off: list[FloatArray]


class _Search:
    """The search for a field; see `identify_field`. Collective to make, and all of it."""

    def __init__(
        self,
        case: Case,
        key: str,
        measured: Sequence[Measured],
        penalty: Penalty,
        bounds: tuple[float, float],
        petsc: PetscOptions | None,
        comm: MPI.Comm,
        told: Callable[[str], None],
    ) -> None:
        case = case.first_of("statics")
        if case.analysis != "statics":
            raise CaseError(
                "a field is sought in statics", where=case.file, expected="a case with [statics]"
            )
        self.case, self.key, self._petsc, self._comm, self._told = case, key, petsc, comm, told
        self.body = read_body(case, comm)
        self.notes = list[str]()
        self.sets = [self._located(one) for one in measured]
        self.start, self.chosen = self._given()
        self.jumps, self._kind = Jumps(self.body, self.chosen, penalty), penalty
        low, high = (np.log(one / self.start) if one > 0 else -np.inf for one in bounds)
        if not low < 0 < high:
            raise CaseError(
                f"{key} is {self.start:g}, outside of its bounds {bounds[0]:g} to {bounds[1]:g}",
                where="--bounds",
                expected="bounds around the value from which the search starts",
            )
        self._bounds, self.runs = (low, high), 0
        volumes = self.jumps.volumes[self.chosen]
        mean = total(comm, float(volumes.sum())) / total(comm, len(volumes))
        self._roots = np.sqrt(volumes / mean)

    def _located(self, one: Measured) -> tuple[MeasuredField, LocatedPoints]:
        if not isinstance(one, MeasuredField):
            raise CaseError("a curve tells no field", expected="files with columns x, y and ux, uy")
        if not np.isnan(one.times).all():
            raise CaseError(
                "a field is sought from displacements at the end of the load",
                where=one.source,
                expected="no column t",
            )
        field, points, note = located_field(self.body, one)
        self.notes += [note] if note else []
        return field, points

    def _given(self) -> tuple[float, BoolArray]:
        """The number that the case has [SI], and the cells of its material."""
        problem = self.case.make_problem(self.body)
        constants = problem.parameters
        if self.key not in constants or constants[self.key].ufl_shape:
            with locate_errors(self.case.file):
                self.case.value_at(self.key)
            raise CaseError(
                f"{self.key} is no number of a material",
                where="--field",
                expected="such as materials.NAME.E, with a number from which the search starts",
            )
        value = float(constants[self.key].value)
        if not value > 0:
            what = f"{self.key} = {value:g} is not positive"
            raise CaseError(what, where="--field", expected="a number above 0")
        chosen = np.zeros(len(self.body.owned_cells()), dtype=bool)
        name = self.key.split(".")[1]
        for region in problem.regions:
            if region.name == name:
                chosen[region.cells] = True
        return value, chosen

    # --- one run ---

    def values(self, m: FloatArray) -> FloatArray:
        """The constant in owned cells [SI]."""
        result = np.full(len(self.chosen), self.start)
        result[self.chosen] *= np.exp(m)
        return result

    def at(self, m: FloatArray) -> _Point:
        """Solves the case with a field.

        Args:
            m: ln of the constant over that of the case, in the cells of the material.

        Raises:
            SolveError: It has no solution.
        """
        found = list[_Point]()

        def look(newton: Newton, state: State) -> None:
            if state.done >= 1.0:
                found.append(self._differentiated(newton, state))

        self._solved(m, look)
        return found[-1]

    def _solved(
        self, m: FloatArray, look: Callable[[Newton, State], None] | None = None
    ) -> tuple[Problem, State]:
        self.runs += 1
        with locate_errors(self.case.file):
            changed = self.case.changed({self.key: self.values(m)})
            problem = changed.make_problem(self.body)
            solver = self.case.make_solver(problem, petsc=self._petsc)
            assert isinstance(solver, Statics)
            solver.observer = look
            with closing(solver.steps()) as states:
                *_, last = states
        return problem, last

    def _differentiated(self, newton: Newton, state: State) -> _Point:
        misfit = PointMisfit(newton.assembler.problem, self.sets)
        here = Equilibrium(newton, lambda _: [misfit], [misfit], state.t)
        with here.kept(), closing(Adjoint(newton)) as adjoint:
            of_scalars = here.by_scalars()[0]
            value = float(here.evaluated().numbers[0])
            solution = adjoint.solve(misfit.by_unknowns(newton.assembler), of_scalars)
            slopes = CellConstant(self.key, newton.assembler).by_logarithm(solution, misfit)
        return _Point(value, slopes[self.chosen], misfit.residuals)

    # --- the search ---

    def run(self, noise: float, weight: float | None, iterations: int) -> FieldFound:
        """For one weight, or for ever smaller ones until the differences are the scatter."""
        m: FloatArray = np.zeros(int(np.count_nonzero(self.chosen)))
        point = self.at(m)
        if weight is not None:
            m, point, ended, why = _Descent(self, weight, m, point, _FLAT).run(iterations)
            self._tell(weight, point)
            return self._result(m, point, weight, ended=ended, why=why)
        weight = _FIRST * point.value
        steps = min(iterations, _ON_THE_WAY)
        for _ in range(_STAGES):
            m, point, _, _ = _Descent(self, weight, m, point, _FLAT_ON_THE_WAY).run(steps)
            self._tell(weight, point)
            if _rms(point.off) <= _ENOUGH * noise:
                why = "the differences are as large as the scatter"
                return self._result(m, point, weight, ended=True, why=why)
            weight /= _LESS
        why = f"the differences stay above the scatter of {quantity(noise, 'm')}"
        return self._result(m, point, _LESS * weight, ended=False, why=why)

    def _tell(self, weight: float, point: _Point) -> None:
        size = percent(_rms(point.off) / _size(self.sets))
        if self._comm.rank == 0:
            self._told(f"weight {weight:.2g}: {size} off, {self.runs} runs")

    def _result(
        self, m: FloatArray, point: _Point, weight: float, *, ended: bool, why: str
    ) -> FieldFound:
        whole = np.zeros(len(self.chosen))
        whole[self.chosen] = m
        sets = tuple(
            ComparedSet(field, field.values + off)
            for (field, _), off in zip(self.sets, point.off, strict=True)
        )
        problem, state = self._solved(m)
        values = np.where(self.chosen, self.values(m), np.nan)
        return FieldFound(
            self.case,
            self.key,
            problem,
            state,
            values,
            self.chosen,
            sets,
            tuple(points.of_cells(values, self._comm) for _, points in self.sets),
            weight,
            (self._kind, self.jumps.value(whole)[0]),
            ended,
            why,
            self.runs,
            tuple(self.notes),
        )

    def penalised(self, m: FloatArray, point: _Point, weight: float) -> tuple[float, FloatArray]:
        """Misfit and penalty, with slopes by m."""
        whole = np.zeros(len(self.chosen))
        whole[self.chosen] = m
        penalty, slopes = self.jumps.value(whole)
        return point.value + weight * penalty, point.slopes + weight * slopes[self.chosen]

    @property
    def bounds(self) -> tuple[float, float]:
        """Of m."""
        return self._bounds

    @property
    def roots(self) -> FloatArray:
        """Roots of the volumes of the cells of the material over their mean."""
        return self._roots

    @property
    def comm(self) -> MPI.Comm:
        """The ranks that compute one run together."""
        return self._comm


def _size(sets: list[tuple[MeasuredField, LocatedPoints]]) -> float:
    return float(max(np.abs(field.values).max() for field, _ in sets))


class _Descent:
    """The search for one weight, by TAO: x = m times the roots of the volumes.  Collective.

    Args:
        m: Where it starts.
        first: The run with the field where it starts.
        flat: Slope that is none.
    """

    def __init__(
        self, search: _Search, weight: float, m: FloatArray, first: _Point, flat: float
    ) -> None:
        self._search, self._weight, self._flat = search, weight, flat
        self._known = m.copy(), first
        self._error, self._walls = list[BaseException](), 0
        self._best = search.penalised(m, first, weight)[0], m.copy(), first

    def run(self, iterations: int) -> tuple[FloatArray, _Point, bool, str]:
        """The best field, the run with it, whether the search has ended, and how."""
        reason = self._solve(iterations)
        _, m, point = self._best
        if reason > 0:
            return m, point, True, "the slope vanishes"
        if reason == _NO_STEP and not self._walls:
            return m, point, True, "no step makes it better"
        why = f"{iterations} iterations are done" if reason == _COUNT else _LOST
        return m, point, False, why

    def _solve(self, iterations: int) -> int:
        """One search from the best field so far; TAO's reason for its end."""
        roots, (low, high) = self._search.roots, self._search.bounds
        first = PETSc.Vec().createMPI((len(roots), PETSc.DECIDE), comm=self._search.comm)
        x, lowest, highest, slope = first, *(first.duplicate() for _ in range(3))
        x.array_w[:] = roots * self._best[1]
        lowest.array_w[:] = roots * low
        highest.array_w[:] = roots * high
        tao = PETSc.TAO().create(self._search.comm)
        try:
            tao.setType("blmvm")
            tao.setVariableBounds(lowest, highest)
            tao.setObjectiveGradient(self._evaluate, slope)
            tao.setTolerances(gatol=0.0, grtol=0.0, gttol=self._flat)
            tao.setMaximumIterations(iterations)
            try:
                tao.solve(x)
            except PETSc.Error:  # which says nothing of an exception in `_evaluate`
                if self._error:
                    raise self._error[0] from None
                raise
            return int(tao.getConvergedReason())
        finally:
            for one in (x, lowest, highest, slope, tao):
                one.destroy()

    def _evaluate(self, tao: PETSc.TAO, x: PETSc.Vec, slope: PETSc.Vec) -> float:
        m = np.asarray(x.array_r / self._search.roots)
        try:
            point = self._run(m)
        except (SolveError, InputError):  # on all ranks alike: the line search goes back
            self._walls += 1
            slope.set(0.0)
            return _WALL * self._best[0] + 1.0
        except BaseException as error:  # raised again when TAO has come back
            self._error.append(error)
            raise
        value, slopes = self._search.penalised(m, point, self._weight)
        if value < self._best[0]:
            self._best = value, m.copy(), point
        slope.array_w[:] = slopes / self._search.roots
        return value

    def _run(self, m: FloatArray) -> _Point:
        same = float(np.array_equal(m, self._known[0]))
        if total(self._search.comm, same) == self._search.comm.size:
            return self._known[1]
        return self._search.at(m)
