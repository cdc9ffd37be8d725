"""When a preconditioner has become too old for the tangent.

Setting multigrid up costs as much as 10 to 50 iterations, so a preconditioner serves for several
tangents; but one of an unloaded bracket took 483 iterations for a bracket bent by 50 degrees, and
77 after it was set up anew.  Two signs tell:

- before a solve, how much the tangent has changed, |(K - K0) v| / |K0 v| for one random v: an
  estimate of the same quotient of Frobenius norms by one product (M. Hutchinson, Commun. Stat.
  Simul. Comput. 19 (1990) 433), whatever it is that has changed, shape, stress or time step;
- after it, how many iterations a digit of the residual has taken.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.linear.random_vector import random_vector

CHANGE = {"displacement": 0.5, "mixed": 0.05}
"""Relative change of the tangent from which its preconditioner is set up anew: with pressures a
changed tangent costs many more iterations."""

GROWTH = 1.2
"""Iterations a digit over those of the first solve from which it is, too."""

SPARE = {"displacement": 8.0, "mixed": 3.0}
"""Further iterations a digit that cost less than a set-up, which takes the time of 25 iterations
where the displacement is the only unknown."""


class Age:
    """Watches the tangents and iterations of one preconditioner.  Collective to make.

    Attributes:
        kept: The preconditioner is of an earlier tangent than the last one.
    """

    def __init__(self, assembler: Assembler) -> None:
        self._assembler, self.kept = assembler, False
        self._v, self._product = assembler.create_vector(), assembler.create_vector()
        rows = assembler.displacement_dofs
        first = self._v.getOwnershipRange()[0]
        self._v.array_w[rows] = random_vector(first, len(rows))
        self._v.array_w[assembler.prescribed_dofs] = 0.0
        self._then: FloatArray | None = None
        kind = "mixed" if assembler.problem.unknowns.auxiliary_fields else "displacement"
        self._change, self._spare, self._first = CHANGE[kind], SPARE[kind], 0.0

    def forget(self) -> None:
        """There is no preconditioner any more. Not collective."""
        self._then, self.kept = None, False

    def begin(self, tangent: PETSc.Mat) -> None:
        """A preconditioner of this tangent is set up. Collective."""
        self._then, self._first, self.kept = self._times(tangent), 0.0, False

    def take(self, tangent: PETSc.Mat) -> bool:
        """Whether the preconditioner is too old for this tangent, or is none. Collective."""
        if self._then is None:
            return True
        self.kept = True
        now = self._times(tangent)
        squares = np.array([np.sum((now - self._then) ** 2), np.sum(self._then**2)])
        off, size = total(self._assembler.comm, squares)
        return not off <= self._change**2 * size  # no numbers count as a change

    def served(self, iterations: int, digits: float) -> bool:
        """Whether a solve has taken no more iterations than a set-up saves. Not collective.

        Args:
            digits: By how many powers of ten the residual was to fall.
        """
        effort = iterations / digits
        self._first = self._first or effort
        return effort <= GROWTH * self._first + self._spare

    def _times(self, tangent: PETSc.Mat) -> FloatArray:
        tangent.mult(self._v, self._product)
        return np.asarray(self._product.array_r[self._assembler.displacement_dofs].copy())

    def destroy(self) -> None:
        """Frees its vectors. Collective."""
        self._v.destroy()
        self._product.destroy()
