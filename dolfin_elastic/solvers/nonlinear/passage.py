"""Steps of Newton's method past bodies that must not pass through each other."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.nonlinear.bordered import Bordered

OVERSHOOT = 0.5
"""Slope of the potential at the end of a step over that at its start, up to which it may rise."""

HALVINGS = 12
"""Of a step that overshoots."""

FLAT = 0.5
"""Slope at the end of a step over that at its start from which on the step is too short."""

DOUBLINGS = 3
"""Of a step that is too short."""


class PassageGuard:
    """Ends a step before anything meets, and at about the minimum of the potential along it.

    Barriers grow without bound as bodies approach, so a full step of Newton's method may end far up
    the other side; where one body rolls off another, the semidefinite tangent is much too stiff.
    The slope of the potential along a step y is the work of the residual f on it, -f . y; while it
    is positive and not much smaller than it was, the minimum lies well before, and while it has
    hardly changed, far behind.  That asks for no energy, which not all laws and forces have.  An
    exact tangent that leads up is replaced by the semidefinite one.

    Source: J. Nocedal & S. J. Wright, Numerical Optimization, 2nd ed., Springer 2006, section 3.1
    (curvature condition, modified tangents); Li et al. (2020), see `bodies.barrier` (steps up to
    contact).

    Args:
        snes: Calls `shorten`.
        unknowns: Of which its vectors are: scalars may stand behind the fields.
    """

    def __init__(
        self, assembler: Assembler, snes: PETSc.SNES, unknowns: Assembler | Bordered
    ) -> None:
        self._assembler, self._snes = assembler, snes
        self._trial, self._f = unknowns.create_vector(), unknowns.create_vector()

    def shorten(self, x: PETSc.Vec, y: PETSc.Vec) -> bool:
        """Shortens the step y from x to x - y, or makes it longer or another one. Collective.

        Returns:
            Whether y was changed.
        """
        other = self._turn_down(x, y)
        slope = self._snes.getFunction()[0].dot(y)
        share = free_share(self._assembler, x, y)
        for _ in range(HALVINGS):
            end = self._slope_at(x, y, share)
            if np.isfinite(end) and end >= -OVERSHOOT * abs(slope):
                break
            share /= 2
        if share == 1.0:
            share = self._lengthened(x, y, slope, end)
        if share != 1.0:
            y.scale(share)
        return other or share != 1.0

    def _turn_down(self, x: PETSc.Vec, y: PETSc.Vec) -> bool:
        """Replaces a step of an exact tangent that leads up. Collective."""
        f = self._snes.getFunction()[0]
        if f.dot(y) > 0.0 or not self._assembler.problem.terms.make_convex():
            return False
        J, P = self._snes.getJacobian()[:2]
        self._snes.computeJacobian(x, J, P)
        self._snes.ksp.setOperators(J, P)
        self._snes.ksp.solve(f, y)
        return True

    def _lengthened(self, x: PETSc.Vec, y: PETSc.Vec, slope: float, end: float) -> float:
        """The share to which a whole step, which is free, is lengthened. Collective.

        Args:
            slope: Minus the slope of the potential along y at x, see `_slope_at` [J].
            end: The same at x - y, after the whole step [J].
        """
        share = 1.0
        for _ in range(DOUBLINGS):
            if not end > FLAT * slope > 0.0:
                break
            free = free_share(self._assembler, x, y, share)
            end = self._slope_at(x, y, share * (1 + free))
            if not (np.isfinite(end) and end >= -OVERSHOOT * slope):
                break
            share *= 1 + free
            if free < 1.0:
                break
        return share

    def _slope_at(self, x: PETSc.Vec, y: PETSc.Vec, share: float) -> float:
        """Minus the slope of the potential along y, after a share of it. Collective."""
        self._trial.waxpy(-share, y, x)
        self._snes.computeFunction(self._trial, self._f)
        return float(self._f.dot(y))

    def destroy(self) -> None:
        """Frees its vectors."""
        self._trial.destroy()
        self._f.destroy()


def leads_through(
    problem: Problem, put: Callable[[FloatArray], None], there: FloatArray, here: FloatArray
) -> bool:
    """Whether surfaces pass each other unseen on the way to other unknowns. Collective.

    Args:
        put: Changes the unknowns of the problem, to those of `here` in the end.
    """
    ends = []
    for unknowns in (there, here):
        put(unknowns)
        ends.append(problem.u.x.array.copy())
    return problem.terms.longest_step(np.asarray(ends[0] - ends[1])) < 1.0


def free_share(assembler: Assembler, x: PETSc.Vec, y: PETSc.Vec, start: float = 0.0) -> float:
    """The share of the step from x to x - y before anything passes unseen. Collective.

    The problem is where the step begins afterwards.

    Args:
        start: Share of y that lies behind; the step is as long once more, or y itself.
    """
    motion = motion_of(assembler, x, y, start)
    return assembler.problem.terms.longest_step(motion)


def motion_of(assembler: Assembler, x: PETSc.Vec, y: PETSc.Vec, start: float = 0.0) -> FloatArray:
    """Of all local nodes in the step from x to x - y, see `free_share` [m]. Collective."""
    problem, own, ends = assembler.problem, assembler.size, []
    for part in (2 * start if start else 1.0, start):
        w = problem.w.x
        w.array[:own] = assembler.origin + (x.array_r[:own] - part * y.array_r[:own])
        assembler.extend(w.array)
        w.scatter_forward()
        problem.unknowns.w_to_u()
        ends.append(problem.u.x.array.copy())
    return np.asarray(ends[0] - ends[1])
