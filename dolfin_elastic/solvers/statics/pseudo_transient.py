"""Pseudo-transient continuation: from a state that lost its equilibrium to a stable one.

(K + theta |diag K|) du = -R with theta that falls as the residual does: backward Euler steps of the
flow D du/dt = -R, which goes downhill in energy, that end as Newton's method.  Source: C. T. Kelley
and D. E. Keyes, SIAM J. Numer. Anal. 35 (1998) 508, "switched evolution relaxation".
"""

from __future__ import annotations

import logging

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.diagnostics.negative_curvature import start_vector
from dolfin_elastic.solvers.diagnostics.stability import Verdict, judge
from dolfin_elastic.solvers.nonlinear.convergence import UNSTABLE, NewtonResult
from dolfin_elastic.solvers.nonlinear.newton import Newton
from dolfin_elastic.solvers.statics.retry import RetryStrategy

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

HALVINGS = 20
"""Times that a perturbation which turns a cell inside out is halved."""


def flow_to_equilibrium(
    retry: RetryStrategy, unstable: Verdict | None
) -> tuple[NewtonResult, Verdict | None]:
    """Lets a body flow to a stable equilibrium. Collective.

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
    sizes = [1e-2 * newton.cell_size, *(share * newton.span for share in PERTURBATIONS)]
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
    result = retry.close_contacts(result, "basic")
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
