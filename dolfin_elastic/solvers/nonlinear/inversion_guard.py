"""No trial state of Newton's method may hold a cell that is inside out."""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.nonlinear.bordered import Bordered
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch

HALVINGS = 10
"""Times that one Newton step is halved before it is given up."""

PATIENCE = 12
"""Shortened steps in one solve from which a smaller load step gets there sooner."""


class InversionGuard:
    """Shortens Newton steps that would turn a cell inside out, before they are tried.

    Laws that grow without bound as J goes to zero say so by an infinite residual; others let a
    cell pass through zero volume and find an equilibrium on the other side of it.  So det F is
    looked at itself, at the points where the energy is integrated.

    Args:
        assembler: Of the problem that is solved.
        bordered: Scalar unknowns beside the fields, on which F may depend.

    Attributes:
        rejected: Trial states refused since `begin`.
        worst: Smallest det F of them and the reference place of its cell [m].
        stuck: No part of the last step was without inverted cells.
    """

    def __init__(self, assembler: Assembler, bordered: Bordered | None = None) -> None:
        self._assembler, self._bordered = assembler, bordered
        self.watch = JacobianWatch(assembler.problem)
        self.begin()

    def begin(self) -> None:
        """Forgets what was refused."""
        self.rejected, self.stuck = 0, False
        self.worst: tuple[float, Any] = (np.inf, np.zeros(3))

    def shorten(self, x: PETSc.Vec, y: PETSc.Vec) -> bool:
        """Halves the step y until x - y has no inverted cell. Collective.

        Returns:
            Whether y was changed.
        """
        size, w = self._assembler.size, self._assembler.problem.w.x
        step = y.array_r[:size].copy()
        share = 1.0
        for _ in range(HALVINGS + 1):
            w.array[:size] = self._assembler.origin + (x.array_r[:size] - share * step)
            w.scatter_forward()
            self._move_scalars(x, y, share)
            found = self.watch.smallest()
            if found[0] > 0.0:
                break
            self.rejected += 1
            self.worst = min(self.worst, found, key=lambda pair: pair[0])
            share /= 2
        else:
            self.stuck = True
        if share < 1.0:
            y.scale(share)
        return share < 1.0

    def _move_scalars(self, x: PETSc.Vec, y: PETSc.Vec, share: float) -> None:
        if (bordered := self._bordered) is not None:
            bordered.border.put(bordered.scalars(x) - share * bordered.scalars(y))
