"""Residual and tangent of a problem as PETSc objects, for a solver of one's own."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from petsc4py import PETSc

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.amplitude import PROPORTIONAL
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler


class Equations:
    """The equations F(x) = 0 of a static problem at a load, and their derivative K(x).

    Collective, all of it.  Vectors have the owned entries of `problem.w` (the displacement [m],
    and a pressure where there is one) in the order of its dofmap, and no ghosts; F is in [N].
    Prescribed entries have rows x - g, with ones on the diagonal of K, whose columns are zero there
    and moved to F: with K dx = -F the first step of Newton's method brings supports to their
    places.  The problem takes over the x that it was evaluated at.

    It owns its objects and destroys them at the end of a ``with`` block, or by `destroy`.

    Args:
        t: Load parameter; 1 is the full load.

    Attributes:
        x: A vector of the problem's unknowns, at first its present ones.

    Raises:
        InputError: The problem has scalar unknowns, such as the pressure of a cavity.

    Example:
        with Equations(problem) as equations:
            K, F = equations.tangent(equations.x), equations.residual(equations.x)
    """

    def __init__(self, problem: Problem, t: float = 1.0) -> None:
        if problem.terms.scalars:
            raise InputError(
                f"'{problem.terms.scalars[0].label}' has an unknown of its own, which is no entry "
                "of a vector of nodes",
                expected="Statics, which solves for it, too",
            )
        problem.set_time(t, default=PROPORTIONAL)
        self._assembler = Assembler(problem)
        self.x, self._F = (self._assembler.create_vector() for _ in range(2))
        self._assembler.get(self.x)

    def residual(self, x: PETSc.Vec) -> PETSc.Vec:
        """F at x: nodal forces out of balance [N]; the next call overwrites it."""
        self._assembler.residual.evaluate(x, self._F)
        return self._F

    def tangent(self, x: PETSc.Vec) -> PETSc.Mat:
        """K at x [N/m], a matrix of PETSc's entries; the next call overwrites it."""
        self._assembler.tangent.invalidate()
        self._assembler.tangent.assemble(x)
        return self._assembler.tangent.matrix

    def destroy(self) -> None:
        """Frees matrix and vectors."""
        for vector in (self.x, self._F):
            vector.destroy()
        self._assembler.destroy()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.destroy()
