"""Energy of volume strains that the pressure of a stage does not belong to.

The strain energy of a material with a pressure unknown is stationary in the pressure: with p* of
the displacement, (p*, q)/k = (g(u), q) for all q, it is the law's own, and with any other p it is
smaller by int (p* - p)^2/(2k).  Implicit schemes whose forces are those of a stage have the
pressure of that stage, not the one of the displacement at the end of the step.  Where steps do not
resolve waves of pressure, the difference is all of their energy.

Source: F. Brezzi and M. Fortin, Mixed and Hybrid Finite Element Methods (1991), section I.3.
"""

from __future__ import annotations

import ufl
from dolfinx import fem, la
from petsc4py import PETSc

from dolfin_elastic.core.parallel import total
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import compiled
from dolfin_elastic.solvers.assembly.matrix import BilinearForm, TangentMatrix
from dolfin_elastic.solvers.audit.equilibrium import no_balance

_TOLERANCE = 1e-8
"""Relative residual of p* - p: its energy has the square of it."""


class PressureEnergy:
    """What the pressure leaves out of the strain energy. Collective to make.

    Args:
        problem: What moves; `compressible` is not empty.
    """

    def __init__(self, problem: Problem) -> None:
        parts = self.compressible(problem)
        space = fem.functionspace(problem.body.mesh, ("Lagrange", 1))
        p, q = ufl.TrialFunction(space), ufl.TestFunction(space)
        F = problem.weak_form.F(problem.w)
        gap = sum(problem.weak_form.volume_gap(part, F, q) for part in parts)
        mass = sum(part.compliance * p * q * problem.weak_form.volume(part, 2) for part in parts)
        self._gap = compiled(problem, [gap])[0]
        self._matrix = TangentMatrix(BilinearForm(compiled(problem, [mass])[0]))
        self._matrix.assemble([])
        self._comm, self._map = problem.body.comm, space.dofmap.index_map
        self._x, self._b = self._matrix.petsc.createVecs()
        self._ksp = PETSc.KSP().create(self._comm)
        self._ksp.setType("cg")
        self._ksp.getPC().setType("jacobi")
        self._ksp.setOperators(self._matrix.petsc)
        self._ksp.setTolerances(rtol=_TOLERANCE, atol=1e-300, max_it=500)

    @staticmethod
    def compressible(problem: Problem) -> list[MaterialRegion]:
        """Regions whose pressure has an energy; none where the audit judges none."""
        if no_balance(problem):
            return []
        regions = [part for part in problem.regions if part.compliance is not None]
        return [part for part in regions if not part.incompressible]

    def energy(self) -> float:
        """Energy of p* less the present pressure [J]; NaN if p* is not found. Collective."""
        rows = la.vector(self._map, 1)
        fem.assemble_vector(rows.array, self._gap)
        rows.scatter_reverse(la.InsertMode.add)
        self._b.array_w[:] = rows.array[: self._map.size_local]
        self._ksp.solve(self._b, self._x)
        if self._ksp.getConvergedReason() < 0:
            return float("nan")
        return float(total(self._comm, 0.5 * float(self._b.array_r @ self._x.array_r)))

    def destroy(self) -> None:
        """Frees what it owns. Collective."""
        for thing in (self._ksp, self._x, self._b, self._matrix):
            thing.destroy()
