"""The equation of the pressure in a step: for the volumes at its ends, not at its stage.

The volume of a mean displacement is not the mean volume: the mean of two positions of a point that
rotates lies on the chord of its arc, too near to the axis by the square of the angle.  With g = 0
at the stage, u_s = (1 - alpha_f) u1 + alpha_f u0, points of a rotating body end outside of their
circle in one step and on it in the next.  The acceleration for that is as large as the centripetal
one, however small the step: the pressure swings between nothing and twice its value.  So the
equation is

    (1 - alpha_f) g(u1) + alpha_f g(u0) = p/k,

p of the stage, and of exactly incompressible materials, 1/k = 0, g(u1) = 0.  The work of p over a
step is then the change of p^2/(2k) but for terms of the third order of the step.

Sources: J. C. Simo & N. Tarnow, ZAMP 43 (1992) 757 (stresses of mean strains, not of the mean
displacement); M. Arnold & O. Bruels, BIT 47 (2007) 185, (14) (constraints at the end of each step
of generalized-alpha); F. Brezzi & M. Fortin, Mixed and Hybrid Finite Element Methods (1991),
section I.3 (energy).

The strain energy is stationary in the pressure: with p* of the displacement, (p*, q)/k = (g(u), q)
for all q, it is the law's own, and with the p of the stage it is smaller by int (p* - p)^2/(2k).
Where steps do not resolve waves of pressure, the difference is all of their energy.

The tangent keeps the gradient of g at the stage in these rows, so that it stays symmetric; it is
off by the angle of rotation in a step, and Newton's method takes 5 iterations instead of 3
where that is 0.1 rad.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import ufl
from dolfinx import fem, la
from petsc4py import PETSc
from ufl.core.expr import Expr

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.problem.material_regions import MaterialRegion
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled
from dolfin_elastic.solvers.assembly.matrix import BilinearForm, TangentMatrix
from dolfin_elastic.solvers.audit.equilibrium import no_balance

_TOLERANCE = 1e-8
"""Relative residual of p* - p: its energy has the square of it."""


class VolumeConstraint:
    """Replaces the pressure's rows at the stage by the volume constraint at the end of the step.

    Collective to make.

    Args:
        alpha_f: Share of the old displacement in the stage's.
    """

    def __init__(self, assembler: Assembler, alpha_f: float) -> None:
        self._assembler, self._problem = assembler, assembler.problem
        self._share = alpha_f
        parts = [part for part in self._problem.regions if part.compliance is not None]
        compressible = [part for part in parts if not part.incompressible]
        q = self._problem.unknowns.auxiliary("pressure", ufl.TestFunction(self._problem.W))
        forms = [_strain(self._problem, group, q) for group in (parts, compressible) if group]
        compiled_forms = compiled(self._problem, forms)
        self._with_pressure, self._compressible = (
            compiled_forms[0],
            compiled_forms[1] if compressible else None,
        )
        entries = np.ones(len(self._problem.w.x.array), dtype=bool)
        displacements = np.arange(len(self._problem.u.x.array), dtype=np.int32)
        entries[self._problem.unknowns.mixed_dofs(displacements)] = False
        self._scalars = entries
        self._old: FloatArray = np.empty(0)
        self._compressible_part: FloatArray = np.zeros(assembler.size)
        self._end = 0.0

    @staticmethod
    def needed(problem: Problem, alpha_f: float) -> bool:
        """Whether there is a pressure, and a stage that is not the end of the step.

        In plane stress the stretch out of the plane takes up the volume.

        Args:
            alpha_f: Share of the old displacement in the stage's.
        """
        return alpha_f > 0.0 and problem.mixed and not problem.unknowns.has("stretch")

    def begin(self, t: float) -> None:
        """Stores the displacement at the start of a step. Collective.

        Args:
            t: Time of the start [s].
        """
        self._problem.set_time(t)
        self._old = self._problem.w.x.array.copy()
        self._compressible_part = self._share * self._rows(self._compressible, self._old)

    def end_at(self, t: float) -> None:
        """Sets the end of the step that is tried. Not collective.

        Args:
            t: Its time [s], of which growth and temperatures are taken, too.
        """
        self._end = t

    def complete(self) -> None:
        """Adds the difference of the constraints at step and stage to the residual. Collective."""
        here, s = self._problem.w.x.array.copy(), self._share
        end = self._old + (here - self._old) / (1 - s)
        more = self._compressible_part - self._rows(self._with_pressure, here)
        now = float(self._problem.t.value)
        self._problem.set_time(self._end)
        more += (1 - s) * self._rows(self._with_pressure, end)
        self._problem.set_time(now)
        self._problem.w.x.array[:] = here
        self._assembler.residual.vector.array[: len(more)] += more

    def _rows(self, form: fem.Form | None, w: FloatArray) -> FloatArray:
        """g of a displacement at zero pressure, in the rows of all unknowns [N].

        Args:
            form: Of the regions that count; None: of none.
            w: All unknowns, local entries.
        """
        if form is None:
            return np.zeros(self._assembler.size)
        self._problem.w.x.array[:] = np.where(self._scalars, 0.0, w)
        forces = self._assembler.reactions.nodal(form)
        self._problem.w.x.array[:] = w
        return forces


def _strain(problem: Problem, parts: Sequence[MaterialRegion], q: Expr) -> ufl.Form:
    F = problem.weak_form.F(problem.w)
    return sum(problem.weak_form.volume_gap(part, F, q) for part in parts)


class PressureEnergy:
    """What the pressure of the stage leaves out of the strain energy. Collective to make.

    Args:
        problem: What moves; `compressible` is not empty.
    """

    def __init__(self, problem: Problem) -> None:
        parts = self.compressible(problem)
        space = fem.functionspace(problem.body.mesh, ("Lagrange", 1))
        p, q = ufl.TrialFunction(space), ufl.TestFunction(space)
        mass = sum(part.compliance * p * q * problem.weak_form.volume(part, 2) for part in parts)
        self._gap = compiled(problem, [_strain(problem, parts, q)])[0]
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
        return [p for p in problem.regions if p.compliance is not None and not p.incompressible]

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
