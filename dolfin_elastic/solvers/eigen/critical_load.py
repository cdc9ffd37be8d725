"""Critical factors: where a stiffness that changes with the load becomes singular, by SLEPc.

(K + value G) u = 0 with K positive is -G u = theta K u with theta = 1/value: the smallest positive
values are the largest theta, found by Krylov-Schur iterations or LOBPCG in the inner product of K.
By Sylvester's law of inertia K + number G has as many negative eigenvalues as there are values
between zero and the number.  With a pressure beside the displacement K is that of a saddle point;
then the iterations use no inner product, and what is not real is no critical factor.

Source: G. Golub and C. Van Loan, Matrix Computations (2013), sections 8.1.5 and 8.7.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

from dolfin_elastic.core.startup.slepc import SLEPc
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.eigen.lobpcg import Cycle, Preconditioned
from dolfin_elastic.solvers.eigen.mode_shapes import complete
from dolfin_elastic.solvers.eigen.slepc import SPARE, Pair, Pencil, Search, prefixed
from dolfin_elastic.solvers.linear.choice import factorising

log = logging.getLogger("dolfin_elastic")

SMALLEST = 1e-9
"""Share of the largest theta that is round-off: such a factor is none."""

REAL = 1e-6
"""Imaginary over real part of theta up to which it is real."""


class CriticalLoad(Pencil):
    """Critical factors of a stiffness A under loads, -B its change per load factor. Collective."""

    _cycle: Cycle | None = None

    def leave_blocks(self) -> str:
        """See `Pencil`: factors."""
        self.options.update(prefixed(factorising(True)))
        self.counted = True
        return "factorising"

    def ritz(self, value: float) -> float:
        """See `Pencil`: -theta, and the factor for it."""
        return -1.0 / value

    def preconditioned(self, shift: float) -> Preconditioned:
        """See `Pencil`."""
        assert self._cycle is not None
        return Preconditioned(self.B, self.A, self._cycle, sign=-1.0, of_B=True)

    def lowest(self, count: int, cycle: Cycle | None) -> list[Pair]:
        """The smallest positive values, none missing; fewer where there are no more. Collective.

        Args:
            cycle: Of A; without it, or with options of the user, A is factorised.
        """
        self._cycle = cycle
        if cycle is None or self.options.users:
            self.leave_blocks()
        room = int(self.A.getSize()[0]) - 1
        if not self.pressures:
            return self.in_double(complete(self, 0.0, count, room=room)[:count])
        pairs = self.near(Search(0.0, count, room, spare=SPARE))
        log.info("with a pressure beside the displacement critical factors are not counted")
        return pairs[:count]

    def set_up(self, eps: SLEPc.EPS, shift: float, count: int, room: int) -> None:
        """See `Pencil`."""
        kind = SLEPc.EPS.ProblemType
        eps.setOperators(self.B, self.A)
        eps.setProblemType(kind.GNHEP if self.pressures else kind.GHEP)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.LARGEST_REAL)
        eps.setDimensions(nev=count)
        eps.getST().setType(SLEPc.ST.Type.SHIFT)
        eps.getST().setShift(0.0)

    def chosen(
        self, eps: SLEPc.EPS, pairs: Sequence[tuple[complex, FloatArray]], shift: float, count: int
    ) -> list[Pair]:
        """See `Pencil`; what is not real, or round-off, is left out."""
        top = max((abs(theta) for theta, _ in pairs), default=0.0)
        real = [
            Pair(1.0 / theta.real, v)
            for theta, v in pairs
            if theta.real > SMALLEST * top and abs(theta.imag) <= REAL * theta.real
        ]
        return sorted(real, key=lambda pair: pair.value)
