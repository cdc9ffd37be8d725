"""Critical factors: where a stiffness that changes with the load becomes singular, by SLEPc.

(K + value G) u = 0 with K positive is -G u = theta K u with theta = 1/value: the smallest positive
values are the largest theta, found by Krylov-Schur iterations in the inner product of K.  By
Sylvester's law of inertia K + number G has as many negative eigenvalues as there are values
between zero and the number.  With a pressure beside the displacement K is that of a saddle point;
then the iterations use no inner product, and what is not real is no critical factor.

Source: G. Golub and C. Van Loan, Matrix Computations (2013), sections 8.1.5 and 8.7.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

from petsc4py import PETSc

from dolfin_elastic.core.petsc_options import PREFIX, PetscOptions
from dolfin_elastic.core.startup.slepc import SLEPc
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.eigen.mode_shapes import SPARE, complete
from dolfin_elastic.solvers.eigen.slepc import Pair, destroy, failing, negative, solve, uneven
from dolfin_elastic.solvers.linear.choice import Choice
from dolfin_elastic.solvers.petsc.options import Options

log = logging.getLogger("dolfin_elastic")

SMALLEST = 1e-9
"""Share of the largest theta that is round-off: such a factor is none."""

REAL = 1e-6
"""Imaginary over real part of theta up to which it is real."""


class CriticalLoad:
    """Critical factors of a stiffness under loads. Collective.

    Args:
        rate: Change of K per load factor.
        sign: 1, or -1 for the loads reversed.
        tolerance: Relative error.

    Attributes:
        counted: They can be counted.
    """

    def __init__(
        self,
        problem: Problem,
        stiffness: PETSc.Mat,
        rate: PETSc.Mat,
        *,
        sign: int,
        choice: Choice,
        users: PetscOptions,
        tolerance: float,
    ) -> None:
        self._problem, self._K, self._G, self._sign = problem, stiffness, rate, sign
        self._options, self._tolerance = Options(choice.options, users), tolerance
        self._pressures = problem.unknowns.count("pressure")
        self.counted = True

    def lowest(self, count: int) -> list[Pair]:
        """The smallest positive values, none missing. Collective."""
        room = int(self._K.getSize()[0]) - 1
        if not self._pressures:
            return complete(self, 0.0, count, room=room)[:count]
        pairs = self.near(0.0, count + SPARE, room=room)
        log.info("with a pressure beside the displacement critical factors are not counted")
        return pairs[:count]

    def below(self, number: float) -> int | None:
        """How many values lie between zero and a number; None: it is one of them. Collective."""
        with stage("solve"):
            changed = self._K.copy()
            changed.axpy(self._sign * number, self._G, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            changed.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            try:
                found = negative(changed)
            finally:
                changed.destroy()
        return None if found is None else found - self._pressures

    def near(
        self,
        shift: float,
        count: int,
        *,
        room: int,
        known: Sequence[FloatArray] = (),
        seed: int = 0,
    ) -> list[Pair]:
        """The smallest positive values, in their order; fewer where there are no more. Collective.

        Args:
            room: How many there may be at all.

        Raises:
            StoppedError: See `solve`.
        """
        count = min(count, room)
        if count < 1:
            return []
        A = self._G.copy()
        A.scale(-float(self._sign))
        eps = SLEPc.EPS().create(A.comm)
        spaces = [self._vector(v) for v in (uneven(self._problem, seed), *known)]
        try:
            self._prepare(eps, A, count)
            eps.setInitialSpace(spaces[0])
            if known:
                eps.setDeflationSpace(spaces[1:])
            with (
                stage("solve"),
                failing(),
                self._options.in_force(),
                self._options.elastic_errors(),
            ):
                eps.setFromOptions()
                solve(eps)
                self._options.report_unused()
            return self._pairs(eps)
        finally:
            destroy(eps, A, *spaces)

    def _prepare(self, eps: SLEPc.EPS, A: PETSc.Mat, count: int) -> None:
        kind = SLEPc.EPS.ProblemType
        eps.setOptionsPrefix(PREFIX)
        eps.setOperators(A, self._K)
        eps.setProblemType(kind.GNHEP if self._pressures else kind.GHEP)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.LARGEST_REAL)
        eps.setTolerances(tol=self._tolerance, max_it=500)
        eps.setDimensions(nev=count)
        eps.getST().setType(SLEPc.ST.Type.SHIFT)
        eps.getST().setShift(0.0)

    def _pairs(self, eps: SLEPc.EPS) -> list[Pair]:
        vector, found = self._vector(None), []
        for k in range(int(eps.getConverged())):
            theta = complex(eps.getEigenpair(k, vector))
            found.append((theta, vector.array_r / float(vector.norm())))
        vector.destroy()
        top = max((abs(theta) for theta, _ in found), default=0.0)
        real = [
            Pair(1.0 / theta.real, v)
            for theta, v in found
            if theta.real > SMALLEST * top and abs(theta.imag) <= REAL * theta.real
        ]
        return sorted(real, key=lambda pair: pair.value)

    def _vector(self, values: FloatArray | None) -> PETSc.Vec:
        vector = self._K.createVecRight()
        if values is not None:
            vector.array_w[:] = values
        return vector
