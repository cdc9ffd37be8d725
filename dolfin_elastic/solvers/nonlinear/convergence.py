"""When Newton's method has found an equilibrium: tolerances, and the round-off below them.

A row of stiff, large entries cannot come closer to zero than a rounding error of them; it is no
excuse for another row, of a soft material beside it.  Source: N. Higham, Accuracy and Stability of
Numerical Algorithms (2002), (3.5): |error| <= n eps sum |K_ij| |x_j|.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.parallel import largest, total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import cell_size, span
from dolfin_elastic.solvers.assembly.assembler import Assembler

UNSTABLE = "an unstable equilibrium"
BEYOND = "the strain energy has no finite value: a material is beyond its limit"
ANOTHER = "another equilibrium than that of the path"


@dataclass
class Progress:
    """What one Newton solve went through.

    Attributes:
        residuals: Norm of the free residual at each iterate [N].
        reference: Force the residual is measured against [N].
        newton: Iterations.
        krylov: Linear iterations.
        reason: PETSc's name of why it ended.
        converged: Whether equilibrium was found.
        rejected: Trial states refused because a cell was inside out.
        worst: Smallest det F of them, and the reference place of its cell [m].
        target: Norm of the free residual that would have been small enough [N].
        predicted: Norm of the first Newton step [m].
        floor: Norm of the free residual that round-off alone may leave [N].
    """

    residuals: list[float] = field(default_factory=list)
    reference: float = 0.0
    newton: int = 0
    krylov: int = 0
    reason: str = ""
    converged: bool = False
    rejected: int = 0
    worst: tuple[float, tuple[float, ...]] | None = None
    target: float = 0.0
    predicted: float = 0.0
    floor: float = 0.0


@dataclass(frozen=True)
class Tolerance:
    """When equilibrium counts as found.

    Attributes:
        rtol: Free residual over the larger of applied forces and reactions.
        atol: Free residual [N].
        max_iterations: Newton iterations after which a step is given up.
    """

    rtol: float = 1e-8
    atol: float = 0.0
    max_iterations: int = 30


SAFETY = 4.0
"""For the cells around a node, each with an error of its own."""

CRUSHED = 1e6
"""Growth of the largest stiffness beyond which a cell is crushed, and excuses nothing more."""


class RoundOff:
    """Rounding errors of the internal forces: epsilon K_ii (h + |u|).

    The stress is known as well as F = I + grad u is, which loses what u itself loses; a body that
    is carried off farther than it is long has no excuse of that kind.  Rows of
    pressures, whose diagonal may be zero, count as a mean row of displacements: pressures are
    scaled to be like them.

    Args:
        assembler: Whose residual.

    Attributes:
        norm: Of all rows [N].
        first: Largest stiffness of the first tangent [N/m].
    """

    def __init__(self, assembler: Assembler) -> None:
        self._assembler = assembler
        self._h, self._span = cell_size(assembler.problem.body), span(assembler.problem.body)
        self._rows: FloatArray = np.zeros(assembler.size)
        self.first, self.norm = 0.0, 0.0

    def renew(self, tangent: PETSc.Mat) -> None:
        """Takes the rows from a fresh tangent. Collective."""
        a = self._assembler
        diagonal = tangent.getDiagonal()
        stiff = np.abs(diagonal.array_r[a.moves])
        diagonal.destroy()
        most = largest(a.comm, float(np.max(stiff, initial=0.0)))
        self.first = self.first or most
        stiff = np.minimum(stiff, CRUSHED * self.first)
        size = SAFETY * np.finfo(float).eps * (self._h + min(a.max_displacement(), self._span))
        square, count = total(a.comm, np.array([np.sum(stiff**2), len(stiff)]))
        self._rows[:] = size * np.sqrt(square / max(count, 1.0))
        self._rows[a.moves] = size * stiff
        self.norm = float(np.sqrt(total(a.comm, float(np.sum(self._rows**2)))))

    def beyond(self) -> float:
        """Norm of what the free rows of the last residual have beyond it [N]. Collective."""
        a = self._assembler
        out = a.balance.array[: a.size]
        rows = np.maximum(np.abs(out - a.constraint_forces(out)) - self._rows, 0.0)
        return float(np.sqrt(total(a.comm, float(np.sum(rows**2)))))
