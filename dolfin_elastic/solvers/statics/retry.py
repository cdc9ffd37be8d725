"""Retries at one load factor, before the load step is made smaller.

Newton's method starts from the last equilibrium or from the extrapolated path, whichever has the
smaller residual: extrapolation saves a third of the iterations in stretching, but in bending it
stretches fibres that only rotate.  Full Newton steps come first: in bending the residual has to
rise before it falls, and a line search that forbids it takes several times the iterations.  If they
fail, backtracking is tried, then the other starting point.  A linear solver that fails is replaced
by a more robust one.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.diagnostics.negative_curvature import start_vector
from dolfin_elastic.solvers.diagnostics.stability import Verdict, judge
from dolfin_elastic.solvers.nonlinear.convergence import UNSTABLE, NewtonResult
from dolfin_elastic.solvers.nonlinear.newton import Newton

log = logging.getLogger("dolfin_elastic")


FIRST = 1.0
"""Shift of the first step, as a share of the tangent's diagonal."""

LARGEST, SMALLEST = 1e3, 1e-6
"""Largest shift, and the smallest one: below it the step is Newton's own."""

ITERATIONS = 400
"""Most steps of one flow: they are shorter than Newton's, so more of them are needed."""

PERTURBATIONS = (1e-2, 1e-1)
"""Displacements, over the body's size, that perturb an unstable equilibrium, after a first one of
a hundredth of a cell.  A slender body returns from perturbations small against its deflection."""

INVERSE_ITERATIONS = 5
"""For the weakest mode: enough for one that stands out."""

UNSETTLED = "gaps remain where there is contact pressure"
"""Why an equilibrium does not count: after a smaller step its multipliers are nearer."""

AUGMENTATIONS = 10
"""Times that what terms remember is renewed in one load step."""

HALVINGS = 20
"""Times that a perturbation which turns a cell inside out is halved."""


def flow_to_equilibrium(
    retry: RetryStrategy, unstable: Verdict | None
) -> tuple[NewtonResult, Verdict | None]:
    """Lets a body flow to a stable equilibrium. Collective.

    Pseudo-transient continuation: from a state that lost its equilibrium to a stable one.

    (K + theta |diag K|) du = -R with theta that falls as the residual does: backward Euler steps of
    the flow D du/dt = -R, which goes downhill in energy, that end as Newton's method. Source: C. T.
    Kelley and D. E. Keyes, SIAM J. Numer. Anal. 35 (1998) 508, "switched evolution relaxation".

    Symmetry can lead the flow to an unstable equilibrium.  The body is then perturbed along its
    weakest mode, farther each time, and flows again.

    Args:
        retry: Of the solver; its problem is at the load and in the state to start from.
        unstable: That state is an equilibrium, which was judged to be unstable; None: it is none.

    Returns:
        How it ended, never with an equilibrium that is known to be unstable; and the verdict on
        that, None if it is none.
    """
    newton = retry.newton
    farther = [1e-2 * newton.cell_size, *(share * newton.span for share in PERTURBATIONS)]
    sizes = [*farther, -farther[0]]  # a little to the other side, too
    result, verdict = NewtonResult(converged=True), unstable
    if verdict is None:
        result = _flow(retry)
        verdict = judge(newton) if result.converged else None
    while verdict is not None and verdict.stable is False:
        saddle, mode = newton.unknowns(), weakest_mode(newton, verdict.direction)
        result = result.refused(UNSTABLE)
        while sizes and not result.converged:
            retry.undo(saddle)
            perturb(newton, mode, sizes.pop(0))
            result = _flow(retry)
        verdict = judge(newton) if result.converged else None
    return result, verdict


def _flow(retry: RetryStrategy) -> NewtonResult:
    newton = retry.newton
    newton.linear.refresh()
    result = newton.solve("basic", shift=_Shift(), max_iterations=ITERATIONS)
    result = retry.settle(result, "basic")
    log.debug("flow to another equilibrium: %s", result.reason)
    return result


class _Shift:
    """Chooses the shift of each step: in proportion to the residual, within bounds.

    The first step is damped as much as the tangent is stiff.  The factor by which the shift falls
    is bounded, lest one lucky step end the flow far from any equilibrium; it grows slowly, for the
    residual rises for a while where a body snaps.
    """

    def __init__(self) -> None:
        self._last, self._shift = 0.0, FIRST

    def __call__(self, residual: float, target: float) -> float:
        """The shift of the next step, as a share of the tangent's diagonal.

        Args:
            residual: Norm of the free residual [N].
            target: Norm that would be small enough [N].
        """
        if self._last > 0.0:
            self._shift *= min(max(residual / self._last, 0.1), 1.5)
        self._last = residual
        self._shift = min(self._shift, LARGEST)
        return self._shift if self._shift > SMALLEST else 0.0


def weakest_mode(newton: Newton, direction: FloatArray | None = None) -> FloatArray:
    """The motion of least stiffness, owned displacements whose largest is 1. Collective.

    Args:
        newton: The solver; its problem is at an equilibrium.
        direction: The motion that the judgement of stability has found; None: it is found by
            inverse iteration with the last tangent.
    """
    assembler = newton.assembler
    x, b = assembler.create_vector(), assembler.create_vector()
    moves = assembler.displacement_dofs
    if direction is None:
        b.array_w[moves] = start_vector(assembler)
        for _ in range(INVERSE_ITERATIONS):
            assembler.remove_constrained(b)
            newton.ksp.solve(b, x)
            _normalise(x)
            x.copy(b)
    else:
        x.array_w[:] = direction
        _normalise(x)
    mode = x.array_r[moves].copy()
    x.destroy()
    b.destroy()
    return np.asarray(mode)


def _normalise(x: PETSc.Vec) -> None:
    x.scale(1.0 / max(float(x.norm(PETSc.NormType.INFINITY)), 1e-300))


def perturb(newton: Newton, mode: FloatArray, size: float) -> None:
    """Perturbs the displacement. Collective.

    Args:
        newton: The solver; its problem is at the equilibrium that is perturbed.
        mode: Owned displacements, of which the largest is 1.
        size: Largest nodal displacement [m]; less where a cell would turn inside out.
    """
    assembler, guard = newton.assembler, newton.guard
    w, moves = assembler.problem.w.x, assembler.displacement_dofs
    start = w.array[moves].copy()
    for halving in range(HALVINGS):
        w.array[moves] = start + size / 2**halving * mode
        w.scatter_forward()
        assembler.problem.unknowns.w_to_u()
        if guard is None or guard.watch.refused()[0] > 0.0:
            break


@dataclass
class RetryStrategy:
    """Tries line searches, linear solvers and starting points until one finds equilibrium.

    Attributes:
        newton: The solver; its problem is at the load that is wanted.
        failed: The last iterate of the last failure, as `Newton.unknowns`.
        spent: Newton iterations of all attempts of the last `solve`.
    """

    newton: Newton
    failed: FloatArray | None = field(default=None, init=False)
    spent: int = field(default=0, init=False)
    _ready: bool = field(default=True, init=False)

    def restarted(self) -> None:
        """Makes the next solve refresh the linear solver, which was set up at another state."""
        self._ready = False

    def solve(self, starts: Sequence[tuple[str, FloatArray]]) -> NewtonResult:
        """Finds equilibrium from the first start that leads there. Collective.

        Args:
            starts: Name for the log and `Newton.unknowns` of each starting point.  The first is
                the last equilibrium, to which the problem returns if all fail.
        """
        newton, first = self.newton, starts[0][1]
        rejected, worst, self.spent = 0, None, 0
        if len(starts) > 1 and self._residual_norm(starts[1][1]) < self._residual_norm(first):
            starts = [("", starts[1][1]), ("from where the last step ended", first)]
        for how, start, line_search in self._attempts(starts):
            if not self._ready:
                newton.linear.refresh()
            self._ready = False  # after a failure it is of a state that was no good
            result = self._attempt(start, line_search)
            self._ready = result.converged
            rejected += result.rejected
            self.spent += result.newton
            if result.worst is not None and (worst is None or result.worst[0] < worst[0]):
                worst = result.worst
            if result.converged:
                if how:
                    log.info("found %s", how)
                return result
            log.debug("%s, line search '%s': %s", how or "start", line_search, result.reason)
        self.failed = newton.unknowns()
        self.undo(first)
        return replace(result, rejected=rejected, worst=worst)

    def undo(self, start: FloatArray) -> None:
        """Goes back to where the step began, the terms too. Not collective."""
        self.newton.put_back(start)
        self.newton.assembler.problem.terms.rollback()

    def _attempts(
        self, starts: Sequence[tuple[str, FloatArray]]
    ) -> Iterator[tuple[str, FloatArray, str]]:
        """Name for the log, starting point and line search of each attempt."""
        searches = self.newton.line_searches()
        for line_search in searches:
            how = "" if line_search == searches[0] else f"by line search '{line_search}'"
            yield how, starts[0][1], line_search
        for how, start in starts[1:]:
            yield how, start, searches[0]

    def _residual_norm(self, start: FloatArray) -> float:
        """Norm of the residual at a start [N]; infinite where a cell is inside out. Collective."""
        assembler, guard = self.newton.assembler, self.newton.guard
        self.newton.put_back(start)
        if guard is not None and guard.watch.refused()[0] <= 0.0:
            return np.inf
        return assembler.residual.norm()

    def _attempt(self, start: FloatArray, line_search: str) -> NewtonResult:
        self.undo(start)
        result = self.newton.solve(line_search)
        while "LINEAR_SOLVE" in result.reason and self.newton.fall_back():
            self.newton.put_back(start)
            result = self.newton.solve(line_search)
        return self.settle(result, line_search)

    def settle(
        self,
        result: NewtonResult,
        line_search: str,
        solve: Callable[[str], NewtonResult] | None = None,
    ) -> NewtonResult:
        """Solves until all terms are settled, and refuses inverted cells. Collective.

        Args:
            result: Of the solve before.
            line_search: PETSc's name of the line search for further solves.
            solve: Finds equilibrium from the problem's present state; by default `newton.solve`.

        Returns:
            How the last solve ended, with the iterations of all and the prediction of the first.
        """
        first, newton, longest, krylov = result, result.newton, result.newton, result.krylov
        terms, solve = self.newton.assembler.problem.terms, solve or self.newton.solve
        for _ in range(AUGMENTATIONS):
            if not (result.converged and terms.solve_again()):
                break
            result = solve(line_search)
            newton, krylov = newton + result.newton, krylov + result.krylov
            longest = max(longest, result.newton)
        else:
            if result.converged and any(term.unsettled() for term in terms if term.multipliers):
                result = result.refused(UNSETTLED)
        result = replace(
            result, newton=newton, longest=longest, krylov=krylov, predicted=first.predicted
        )
        return self._refuse_inverted(result)

    def _refuse_inverted(self, result: NewtonResult) -> NewtonResult:
        """No accepted state has an inverted cell, even if no trial state on the way had one.

        Where the law survives inversion it may have.
        """
        guard = self.newton.guard
        if not result.converged or guard is None:
            return result
        value, place = guard.watch.refused()
        if value > 0.0:
            return result
        unit = self.newton.assembler.problem.body.unit
        return result.inverted(value, place).refused(
            f"an element turned inside out (det F = {value:.3g}, at {unit.point(place)})"
        )
