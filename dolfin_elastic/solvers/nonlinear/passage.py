"""Steps of Newton's method past bodies that must not pass through each other."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.assembler import Assembler

OVERSHOOT = 0.5
"""Slope of the potential at the end of a step over that at its start, up to which it may rise."""

HALVINGS = 12
"""Of a step that overshoots."""


class PassageGuard:
    """Ends a step before anything meets, and halves it while it overshoots its minimum.

    Barriers grow without bound as bodies approach, so a full step of Newton's method may end far up
    the other side.  The slope of the potential along a step y is the work of the residual f on it,
    -f . y; where it is positive and not much smaller than it was, the minimum lies well before.
    That asks for no energy, which not all laws and forces have.

    Source: J. Nocedal & S. J. Wright, Numerical Optimization, 2nd ed., Springer 2006, section 3.1
    (curvature condition); Li et al. (2020), see `bodies.barrier` (steps up to contact).
    """

    def __init__(self, assembler: Assembler, snes: PETSc.SNES) -> None:
        self._assembler, self._snes = assembler, snes
        self._trial, self._f = assembler.create_vector(), assembler.create_vector()

    def shorten(self, x: PETSc.Vec, y: PETSc.Vec) -> bool:
        """Shortens the step y from x to x - y. Collective.

        Returns:
            Whether y was changed.
        """
        slope = self._snes.getFunction()[0].dot(y)
        share = free_share(self._assembler, x, y)
        for _ in range(HALVINGS):
            self._trial.waxpy(-share, y, x)
            self._snes.computeFunction(self._trial, self._f)
            end = self._f.dot(y)
            if np.isfinite(end) and end >= -OVERSHOOT * abs(slope):
                break
            share /= 2
        if share < 1.0:
            y.scale(share)
        return share < 1.0

    def destroy(self) -> None:
        """Frees its vectors."""
        self._trial.destroy()
        self._f.destroy()


def free_share(assembler: Assembler, x: PETSc.Vec, y: PETSc.Vec) -> float:
    """The share of the step from x to x - y before anything passes unseen. Collective.

    The problem is at x afterwards.
    """
    problem, own, ends = assembler.problem, assembler.size, []
    for part in (1.0, 0.0):
        w = problem.w.x
        w.array[:own] = assembler.origin + (x.array_r[:own] - part * y.array_r[:own])
        assembler.extend(w.array)
        w.scatter_forward()
        problem.unknowns.w_to_u()
        ends.append(problem.u.x.array.copy())
    motion: FloatArray = ends[0] - ends[1]
    return problem.terms.longest_step(motion)
