"""The whole load in one step, where nothing speaks for several.

Several load steps find what one of them finds where the response is but mildly nonlinear, and take
twice the Newton iterations.  So the whole load is tried first, and its equilibrium counts only if
it is the one next to the linear solution, by four signs of which each is sharper than what the load
steps themselves are judged by:

- Newton's method gets there as a matter of course: full steps, none of which turns a cell inside
  out, residuals that at least halve from the second step on, `ITERATIONS` at most;
- no iterate from the second on, and not the solution, is farther from the linear solution than
  `NEAR` of its length: `StepSpeed` lets a load step move a body three times as far;
- the energy is that of a nearly proportional response, to `PROPORTIONAL_WORK`;
- the equilibrium is stable, proven by the pivots of the tangent's factors or by conjugate
  gradients, see `judge`.

A body that has snapped fails by its energy, one that has buckled or should have by the tangent.
Where one of these signs cannot be seen (no energy, unsymmetric tangents) or the path is an end in
itself (contact, curves, states that the user has asked for), the load grows step by step from the
start.

What a trial in vain may cost: most are given up after the first or the second Newton step, where a
cell turns inside out, the residual does not fall, or the body moves elsewhere than the linear
solution says.  The hard cases of the tests take one to three iterations for it, of the 30 to 400 of
their load steps; `ITERATIONS` and one linear solve are the most, and what a trial saves.
"""

from __future__ import annotations

import logging

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.amplitude import PROPORTIONAL
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.audit.equilibrium import PathEnergyCheck
from dolfin_elastic.solvers.diagnostics.stability import Verdict, judge
from dolfin_elastic.solvers.messages import in_words
from dolfin_elastic.solvers.nonlinear.convergence import ANOTHER, BEYOND, UNSTABLE, NewtonResult
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.statics.retry import RetryStrategy

log = logging.getLogger("dolfin_elastic")

ITERATIONS = 8
"""Newton iterations of a trial: the load steps of mild cases take 9 to 13 together."""

FALL = 0.5
"""Residual over the one before, from the second iteration on: the first step may raise it a
hundredfold, where a rotation is seen as stretch, but then Newton's method converges or fails."""

NEAR = 0.3
"""Distance from the linear solution over its length: rubber stretched by 30 % has 0.25, a block
bent by a tenth of a turn 0.1; crooked columns beyond their critical load have 0.35."""

PROPORTIONAL_WORK = 0.125
"""Share of half the work of the final forces by which the stored energy may miss it: zero in a
proportional response (Clapeyron); load steps of 25, 50 and 25 % allow 1/16 + 1/4 + 1/16."""

FARTHER = "the solution is far from the linear one"


def may_take_whole_load(problem: Problem) -> bool:
    """Whether the signs above can be seen, and no path has to be followed. Not collective."""
    opens = problem.terms.opens
    if problem.linear or opens or problem.corners or problem.driven_by_formula:
        return False
    if not problem.symmetric or problem.weak_form.strain_energy is None:
        return False
    return problem.history is None and not (
        problem.unknowns.stabilised or problem.eigenstrains or problem.cell is not None
    )


class IterationCheck:
    """Watches the iterates of a trial; see the module.

    Args:
        assembler: Of the problem that is solved, at rest.
    """

    def __init__(self, assembler: Assembler) -> None:
        self._assembler, self._last = assembler, 0.0
        self._linear: FloatArray = np.zeros(0)

    def __call__(self, snes: PETSc.SNES, iteration: int, residual: float) -> bool:
        """Whether the trial is to be given up. Collective.

        Args:
            iteration: Number of the iterate, from 0.
        """
        before, self._last = self._last, residual
        if iteration < 2:
            if iteration == 1:
                self._linear = self._displacement(snes)
            return False
        return not residual <= FALL * before or self.far(snes)

    def _displacement(self, snes: PETSc.SNES) -> FloatArray:
        x = snes.getSolution().array_r[: self._assembler.size]
        return np.asarray(x[self._assembler.displacement_dofs])

    def far(self, snes: PETSc.SNES) -> bool:
        """Whether the present iterate, from the second on, is far from the first. Collective."""
        now = self._displacement(snes)
        squares = np.array([np.sum((now - self._linear) ** 2), np.sum(self._linear**2)])
        off, size = total(self._assembler.comm, squares)
        return bool(off > NEAR**2 * size)


def try_whole_load(
    retry: RetryStrategy, path_check: PathEnergyCheck, end: float
) -> tuple[NewtonResult, Verdict] | None:
    """Looks for the equilibrium next to the linear solution. Collective.

    Args:
        retry: Of the solver, before its first step.

    Returns:
        How it was found, evaluated by `path_check`, and that it is stable; None, all unknowns put
        back, if it is in doubt.
    """
    newton = retry.newton
    problem = newton.assembler.problem
    ours = newton.ksp.getType() in ("preonly", "cg") or newton.linear.split is not None
    if not ours or newton.assembler.max_displacement() > 0.0:  # GMRES that the user asks for
        return None
    start = newton.unknowns()
    problem.set_time(end, default=PROPORTIONAL)
    problem.constraints.check_finite()
    result = _solved(newton, path_check)
    if result.converged and problem.terms.unsettled():
        result = result.refused("a term is to be solved with again")
    if result.converged:
        verdict = judge(newton)
        if verdict.stable:
            retry.restarted()
            return result, verdict
        result = result.refused(UNSTABLE if verdict.stable is False else str(verdict.stability))
    retry.restarted()
    log.debug("the whole load in one step: %s; it grows step by step", in_words(result.reason))
    retry.undo(start)
    return None


def _solved(newton: Newton, path_check: PathEnergyCheck) -> NewtonResult:
    guard, check = newton.guard, IterationCheck(newton.assembler)
    most = min(ITERATIONS, newton.tolerance.max_iterations)
    result = newton.solve("basic", max_iterations=most, check=check)
    if not result.converged:
        return result
    if result.newton > 1 and check.far(newton.snes):
        return result.refused(FARTHER)
    if guard is not None and guard.watch.smallest()[0] <= 0.0:
        return result.refused("an element has turned inside out")
    path_check.evaluate()
    if not path_check.finite():
        return result.refused(BEYOND)
    if path_check.jumped(result.target, share=PROPORTIONAL_WORK):
        return result.refused(ANOTHER)
    return result
