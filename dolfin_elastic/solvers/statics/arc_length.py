"""Following a path of equilibria by its length, through limit points where the load falls.

Unknown are displacement and load factor; the further equation |du|^2 = dl^2 fixes the length of a
step.  Source: M. A. Crisfield, Computers & Structures 13 (1981) 55 (cylindrical arc length); it is
linearised consistently, so Newton's method stays quadratic and no root needs to be chosen.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Any

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.amplitude import PROPORTIONAL
from dolfin_elastic.problem.state import RestartState
from dolfin_elastic.problem.term import OutOfBalance, ScalarUnknowns
from dolfin_elastic.problem.term_list import passed
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.diagnostics.stability import Verdict, judge
from dolfin_elastic.solvers.nonlinear.bordered import JoinedScalars
from dolfin_elastic.solvers.nonlinear.convergence import PASSED, NewtonResult
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.nonlinear.passage import leads_through
from dolfin_elastic.solvers.statics.limit_points import (
    LimitPoint,
    Sample,
    first_reached,
    limit_points,
)
from dolfin_elastic.solvers.statics.retry import RetryStrategy
from dolfin_elastic.solvers.statics.step_size import StepSpeed

log = logging.getLogger("dolfin_elastic")

DESIRED_ITERATIONS = 4
"""Newton iterations of a step of the right length: after more the next is shorter, else longer."""

FIRST_DISPLACEMENT = 0.01
"""Largest displacement of the first step over the size of the body."""

MAX_GROWTH = 8.0
"""Longest step over the first one."""

MIN_COSINE = 0.5
"""Cosine of the angle between successive increments below which the second is repeated."""

LENGTH_TOLERANCE = 1e-6
"""Relative error of the length of a step: it shifts the point along the path, not off it."""

BALANCED = 10.0
"""Error of the load of an equilibrium, over what forces out of balance Newton's method has left."""

FLAT = 1e-6
"""Changes of the load factor, over it, that count as none where a metal flows."""
SLOPE = 1e-8
"""Relative tolerance of an iterative solver for the tangent of the path."""


class ArcLengthConstraint(ScalarUnknowns):
    """The load factor, and the length of the step as its equation."""

    size = 1

    def __init__(self, assembler: Assembler) -> None:
        self._assembler, self._problem = assembler, assembler.problem
        self.steps, self.signs = np.array([1e-4]), np.zeros(1)
        self.prescribing = np.zeros(1, dtype=bool)
        self.t, self._length = 0.0, 1.0
        self._start = self.displacement().copy()

    def begin(self, start: FloatArray | None = None, *, length: float = 1.0) -> None:
        """Begins a step. Not collective.

        Args:
            start: Owned displacements at its beginning [m]; None: the present ones.
            length: Its length [m].
        """
        self._start = self.displacement().copy() if start is None else start
        self._length = length

    def restore(self, t: float) -> None:
        """Goes on at a load factor that the problem has already."""
        self.t = t

    def displacement(self) -> FloatArray:
        """Owned displacements [m]."""
        return np.asarray(self._problem.w.x.array[self._assembler.displacement_dofs])

    def get(self) -> FloatArray:
        """The load factor."""
        return np.array([self.t])

    def put(self, values: FloatArray) -> None:
        """Sets the load factor."""
        self.t = float(values[0])
        self._problem.set_time(self.t, default=PROPORTIONAL)

    def arc(self) -> float:
        """Length of the increment since the beginning of the step [m]. Collective."""
        return float(np.sqrt(self.product(self.increment(), self.increment())))

    def increment(self) -> FloatArray:
        """Owned displacements since the beginning of the step [m]."""
        return self.displacement() - self._start

    def product(self, a: FloatArray, b: FloatArray) -> float:
        """Inner product of two increments. Collective.

        Args:
            a: Owned displacements [m].
            b: Owned displacements [m].
        """
        return float(total(self._assembler.comm, float(np.dot(a, b))))

    def residual(self, forces: OutOfBalance) -> FloatArray:
        """(|du|^2 - dl^2)/dl [m]."""
        return np.array([self.arc() ** 2 / self._length - self._length])

    def rows(self, forces: OutOfBalance) -> list[FloatArray]:
        """Its derivative."""
        row = np.zeros(self._assembler.size)
        row[self._assembler.displacement_dofs] = 2.0 * self.increment() / self._length
        return [row]

    def settled(self, residual: FloatArray, target: float) -> bool:
        """The step has its length."""
        return bool(abs(residual[0]) <= LENGTH_TOLERANCE * self._length)


@dataclass(frozen=True)
class PathPoint:
    """A point of the path, or the failure to find the next one.

    Attributes:
        t: Load factor.
        result: How it was found, or not.
        verdict: Whether it is stable under its load; None where it was not found.
        good: Where it was not found: the last point, as `Newton.unknowns`.
        failed: ... and the last iterate.
    """

    t: float
    result: NewtonResult
    verdict: Verdict | None = None
    good: FloatArray | None = None
    failed: FloatArray | None = None


class ArcLength:
    """Follows a path from the unloaded state to the load factor `end`. Collective to make.

    Args:
        retry: Of the solver for steps of the load: the first and the last.
        end: Load factor at which the path ends, when it is first reached.

    Attributes:
        limits: Limit points passed so far.
    """

    def __init__(self, retry: RetryStrategy, *, end: float) -> None:
        self._newton, self._retry, self._end = retry.newton, retry, end
        self._assembler = self._newton.assembler
        self._problem = self._assembler.problem
        self._length = ArcLengthConstraint(self._assembler)
        others = [] if self._newton.bordered is None else [self._newton.bordered.scalars]
        self._all = JoinedScalars([self._length, *others])
        # Increments of the last step: of all scalars, and of the displacement.
        self._scalar_increment: FloatArray = np.zeros(self._all.size)
        self._increment: FloatArray | None = None
        self.limits: list[LimitPoint] = []
        # At the last point: the slope of the load factor, and negative eigenvalues.
        self._slope = np.nan
        self._negative: int | None = None
        self._size = self._longest = 0.0
        guard = self._newton.guard
        self._bordered = Newton(
            self._assembler,
            self._newton.choice,
            self._newton.tolerance,
            users=self._newton.options.users,
            scalars=self._all,
            watch=None if guard is None else guard.watch,
        )

    def destroy(self) -> None:
        """Frees what it owns. Collective."""
        self._bordered.destroy()

    def path(self, first: float, smallest: float, *, chosen: bool) -> Iterator[PathPoint]:
        """Yields the points of the path; one that did not converge is the last. Collective.

        Args:
            first: Load factor of the first point, which sets the length of steps.
            smallest: Shortest step, as a share of the first.
            chosen: The user has chosen the first step; else it is made small.
        """
        if self._increment is None:
            longest = np.inf if chosen else FIRST_DISPLACEMENT * self._newton.span
            result = self._first(first, smallest, longest)
            if not result.result.converged:
                yield result
                return
            self._increment, self._size = self._length.increment(), self._length.arc()
            self._longest = MAX_GROWTH * self._size
            self._bordered.factorise()
            self._slope, self._negative = self._slopes()[1], _counted(result.verdict)
            yield result
        while self._length.t < self._end * (1 - 1e-12):
            here, t, known = self._newton.unknowns(), self._length.t, len(self.limits)
            check = self._passage_check()
            point = self._next(self._increment)
            if point.result.converged and point.t >= self._end:
                point = self._end_at_load_factor(here, t)
                point = replace(point, result=check(point.result))
                if point.result.reason != PASSED:
                    yield point
                    return
            if not point.result.converged:
                failed = self._newton.unknowns()
                del self.limits[known:]
                self._undo(here, t)
                self._size /= 2
                if self._size < smallest * self._longest / MAX_GROWTH:
                    yield PathPoint(t, point.result, good=here, failed=failed)
                    return
                continue
            yield point

    def _next(self, last: FloatArray) -> PathPoint:
        """The next point of the path; not converged where a shorter step is needed. Collective.

        Args:
            last: Owned displacement increment of the last step [m].
        """
        before, size, here = self._all.get(), self._size, self._newton.unknowns()
        check = self._passage_check()
        result = check(self._step(last, size))
        if not result.converged or self._turns_sharply(last):
            log.debug("arc length %g m: %s, a shorter one", size / 2, result.reason)
            return PathPoint(self._length.t, result.refused(result.reason))
        verdict = judge(self._bordered, surely=False)
        along, slope = self._slopes()
        beginning = self._scalar_increment, self._increment
        self._increment, self._scalar_increment = self._length.increment(), self._all.get() - before
        begin = Sample(0.0, float(before[0]), self._slope)
        end = Sample(self._length.arc(), self._length.t, along)
        inside = _Inside(self, begin.t, here, self._increment)
        limits = self._limits(begin, end, inside)
        samples = [begin, *sorted(inside.found, key=lambda sample: sample.s), end]
        reached = max(sample.t for sample in samples) >= self._end
        if not reached:
            self.limits += limits
            verdict = self._report(begin.t, verdict, limits)
            self._slope, self._negative = slope, _counted(verdict)
            factor = np.sqrt(DESIRED_ITERATIONS / max(result.newton, 1))
            self._size = min(self._longest, size * float(np.clip(factor, 0.5, 2.0)))
        else:
            missed = inside.found and first_reached(samples, self._end, inside) is None
            self._scalar_increment, self._increment = beginning
            if missed:
                return PathPoint(begin.t, result.refused("DIVERGED_MAX_IT"))
            self.limits += takewhile(lambda limit: limit.t < self._end, limits)
        spent = inside.spent
        result = replace(
            result, newton=result.newton + spent.newton, krylov=result.krylov + spent.krylov
        )
        return PathPoint(self._end if reached else self._length.t, result, verdict)

    def find(
        self, t: float, here: FloatArray, last: FloatArray, size: float
    ) -> tuple[Sample | None, NewtonResult]:
        """The point of the path at a distance from a known one; None: not found. Collective.

        Args:
            here: `Newton.unknowns` of it.
            last: Owned displacements in whose direction to go [m].
            size: The distance [m].
        """
        self._undo(here, t)
        result = self._step(last, size)
        if not result.converged:
            return None, result
        return Sample(self._length.arc(), self._length.t, self._slopes()[0]), result

    # --- limit points ---

    def _slopes(self) -> tuple[float, float]:
        """Derivative of the load factor by the distance from the step's beginning [1/m].

        And by the length of the path.  Both follow from the last tangent.  Collective.
        """
        bordered = self._bordered.bordered
        assert bordered is not None
        if not (self._bordered.result.newton or self._bordered.factorised):
            self._bordered.factorise()
        fields, scalars = bordered.tangent(None if self._bordered.linear.direct else SLOPE)
        way, now = fields[self._assembler.displacement_dofs], self._length.increment()
        product = self._length.product
        along = product(way, now) / np.sqrt(product(now, now))
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = scalars[0] / along
            return float(slope), float(np.sign(along) * scalars[0] / np.sqrt(product(way, way)))

    def _limits(self, begin: Sample, end: Sample, inside: _Inside) -> list[LimitPoint]:
        """Limit points inside the step. Collective.

        Afterwards the problem is at the end of the step, as before.
        """
        there, memory = self._bordered.unknowns(), self._problem.terms.memory.values()
        remembered = [field.x.array.copy() for field in memory]
        least = BALANCED * self._newton.tolerance.rtol
        limits = limit_points(begin, end, inside, least=least)
        history, change = self._problem.history, abs(end.t - begin.t)
        if history is not None and history.yields and change < FLAT * abs(end.t):
            limits = []  # a plateau, whose slope is round-off
        if inside.moved:
            self._bordered.put_back(there)
            for field, saved in zip(memory, remembered, strict=True):
                field.x.array[:] = saved
            assert self._bordered.bordered is not None
            self._bordered.bordered.evaluate()
        return limits

    def _report(self, t: float, verdict: Verdict, limits: Sequence[LimitPoint]) -> Verdict:
        """Logs the limit points of a step, and bifurcations that its pivots show. Collective.

        At a limit point one eigenvalue of the tangent changes its sign; what else changes does so
        at a bifurcation, which no slope of the load shows.  Where the numbers differ, the tangent
        of the end itself counts: Newton's last one may belong to the other side of a limit point.

        Returns:
            The verdict, by the tangent of the end itself where it was needed.
        """
        for limit in limits:
            log.info("limit point: load factor %.8g, error about %.1g", limit.t, limit.error)
        negative, before = _counted(verdict), self._negative
        if negative is None or before is None:
            return verdict
        if not _explained(negative - before, len(limits)):
            self._bordered.factorise()
            verdict = judge(self._bordered)
            negative = _counted(verdict)
        if negative is None or _explained(negative - before, len(limits)):
            return verdict
        log.warning(
            "bifurcation between the load factors %.6g and %.6g: the tangent has %d negative "
            "eigenvalues before and %d behind, with %d limit points between; another path branches "
            "off, and small imperfections decide which one a body takes",
            t,
            self._length.t,
            before,
            negative,
            len(limits),
        )
        return verdict

    def restart_state(self) -> RestartState:
        """See `Restartable`; the field "way" is the last increment. Not collective."""
        if self._increment is None:
            return RestartState({})
        way = fem.Function(self._problem.W)
        way.x.array[self._assembler.displacement_dofs] = self._increment
        numbers = {
            "lead": self._scalar_increment.tolist(),
            "size": self._size,
            "longest": self._longest,
            "slope": self._slope,
            "negative": self._negative,
            "limits": [[limit.t, limit.error] for limit in self.limits],
            "newton": self._bordered.restart_state(),
        }
        return RestartState({"way": way}, numbers)

    def restore(self, t: float, way: fem.Function | None, saved: Mapping[str, Any]) -> None:
        """Sets what `restart_state` gave. Collective.

        Args:
            way: The last increment, at all unknowns [m].
        """
        if way is None:
            return
        self._length.restore(t)
        self._increment = way.x.array[self._assembler.displacement_dofs].copy()
        self._scalar_increment = np.array(saved["lead"], dtype=np.float64)
        if self._scalar_increment.shape != self._all.get().shape:
            raise ValueError(f"{len(self._scalar_increment)} increments of the scalar unknowns")
        self._size, self._longest = saved["size"], saved["longest"]
        self._slope, self._negative = saved["slope"], saved["negative"]
        self.limits = [LimitPoint(*limit) for limit in saved["limits"]]
        self._bordered.restore(saved["newton"])

    def _first(self, t: float, smallest: float, longest: float) -> PathPoint:
        """The first step prescribes the load factor and gives the path its direction. Collective.

        It is halved while displacements are too large: a load far above a limit point would lead
        to an equilibrium beyond it at once.

        Args:
            smallest: Shortest step, as a share of t.
            longest: Largest nodal displacement [m].
        """
        least = smallest * t
        while True:
            self._length.begin()
            before = self._all.get()
            before[0] = 0.0
            here = self._newton.unknowns()
            self._length.put(np.array([t]))
            check = self._passage_check()
            result = check(self._retry.solve([("", here)]))
            self._scalar_increment = self._all.get() - before
            too_fast = StepSpeed(self._assembler).too_fast(0.0, t, here, result)
            too_fast = too_fast or self._assembler.max_displacement() > longest
            if result.converged and not (too_fast and t / 2 >= least):
                return PathPoint(t, result, judge(self._newton, surely=False))
            if t / 2 < least:
                return PathPoint(0.0, result, good=here, failed=self._retry.failed)
            self._retry.undo(here)
            t /= 2

    def _step(self, last: FloatArray, size: float) -> NewtonResult:
        """Goes on in the direction of the last step and corrects from there. Collective.

        Args:
            last: Increment of the displacement in the last step, owned entries [m].
            size: Length of this one [m].
        """
        length, w = self._length, self._problem.w
        share = size / np.sqrt(length.product(last, last))
        scalars = share * self._scalar_increment
        # The load factor comes first.  Around a limit point it hardly changes, and its difference
        # must not vanish with it.
        here = self._bordered.unknowns()
        length.begin(length=size)
        self._all.steps[0] = max(1e-4 * abs(scalars[0]), 1e-7 * self._end)
        moves = self._assembler.displacement_dofs
        w.x.array[moves] += share * last
        w.x.scatter_forward()
        self._all.put(self._all.get() + scalars)
        self._problem.unknowns.w_to_u()
        start, put = self._bordered.unknowns(), self._bordered.put_back
        if self._problem.terms.joins and leads_through(self._problem, put, start, here):
            return NewtonResult(reason=PASSED)
        put(start)
        self._bordered.linear.refresh()
        result = self._bordered.solve("basic")
        while "LINEAR_SOLVE" in result.reason and self._bordered.fall_back():
            self._bordered.put_back(start)
            result = self._bordered.solve("basic")
        return self._retry.settle(result, "basic", self._bordered.solve)

    def _turns_sharply(self, last: FloatArray) -> bool:
        """Whether the path turns so sharply that the step may have skipped a part. Collective."""
        now = self._length.increment()
        product = self._length.product
        return product(last, now) < MIN_COSINE * np.sqrt(product(last, last) * product(now, now))

    def _passage_check(self) -> Callable[[NewtonResult], NewtonResult]:
        """Refuses what has passed an obstacle unseen on its way from the present state."""
        u, terms, newton = self._problem.u.x.array, self._problem.terms, self._bordered
        start, poses, here = u.copy(), terms.poses, newton.unknowns()

        def check(result: NewtonResult) -> NewtonResult:
            """The same, or that it has passed one, or ends deep in one. Collective."""
            if not (result.converged and terms.opens):
                return result
            through, end = passed(terms, start - u, poses), newton.unknowns()
            if not terms.joins:  # these Newton's method looks at itself
                through |= leads_through(self._problem, newton.put_back, end, here)
                newton.put_back(end)
            return result.refused(PASSED) if through else result

        return check

    def _undo(self, here: FloatArray, t: float) -> None:
        self._retry.undo(here)
        self._length.put(np.array([t]))

    def _end_at_load_factor(self, here: FloatArray, t: float) -> PathPoint:
        """The last point: equilibrium at the load factor `end`, between the last two points."""
        beyond = self._newton.unknowns()
        share = (self._end - t) / (self._length.t - t)
        self._length.put(np.array([self._end]))
        result = self._retry.solve([("", here + share * (beyond - here)), ("", beyond)])
        if not result.converged:
            return PathPoint(t, result, good=here, failed=self._retry.failed)
        return PathPoint(self._end, result, judge(self._newton))


class _Inside:
    """Finds points of a path inside a step of it. Collective to call.

    Args:
        t: Load factor at the beginning of the step.
        here: `Newton.unknowns` there.
        last: Owned displacement increment of the step [m].

    Attributes:
        found: All points found.
        spent: Iterations for them.
        moved: The problem is not where it was.
    """

    def __init__(self, path: ArcLength, t: float, here: FloatArray, last: FloatArray) -> None:
        self._path, self._begin = path, (t, here, last)
        self.found: list[Sample] = []
        self.spent, self.moved = NewtonResult(), False

    def __call__(self, s: float) -> Sample | None:
        """The point at a distance [m] from the beginning; None: not found."""
        self.moved = True
        sample, result = self._path.find(*self._begin, s)
        self.spent = replace(
            self.spent,
            newton=self.spent.newton + result.newton,
            krylov=self.spent.krylov + result.krylov,
        )
        if sample is not None:
            self.found.append(sample)
        return sample


def _explained(change: int, limits: int) -> bool:
    """Whether so many limit points can change the number of negative eigenvalues by so much."""
    return abs(change) <= limits and (change - limits) % 2 == 0


def _counted(verdict: Verdict | None) -> int | None:
    """Negative eigenvalues of the tangent, None where there may be more of them."""
    if verdict is None or verdict.stability.at_least:
        return None
    return verdict.stability.negative
