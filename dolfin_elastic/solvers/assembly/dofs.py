"""The vector of unknowns: displacement dofs, and dofs with Dirichlet conditions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from dolfinx import fem, la
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.problem.constraints.rows import Rows
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.hydrostatic_constant import HydrostaticConstant
from dolfin_elastic.solvers.assembly.matrix import BilinearForm


class Multiplied(Protocol):
    """A matrix of all unknowns."""

    def times(self, direction: FloatArray) -> FloatArray:
        """Its product with owned entries of a direction [m], of the same shape. Collective."""


class ConstrainedDofs(Rows):
    """Owned dofs of a problem's unknowns, with their constraints. Collective to make.

    Args:
        problem: Whose unknowns; its `w` and `u` are changed by `put`.
        displacement_fixed: All displacements are prescribed: only the scalar fields are unknown.

    Attributes:
        problem: Whose unknowns.
        comm: Its ranks.
        size: Dofs that this rank owns.
        displacement_dofs: Those that belong to the displacement, in the displacement's order.
        level: The bodies whose pressure is known up to a constant; None without any.
        fixed_pressures: Those that `level` fixes.
        bcs: DOLFINx's conditions at `prescribed_dofs` and `fixed_pressures`, ghosts included.
        origin: Offset of vectors of unknowns: zeros, or the predictor of a time step, because
            accelerations are differences of displacements and would lose digits where these are
            large; at pressures a uniform one that is an unknown of its own.
    """

    def __init__(self, problem: Problem, *, displacement_fixed: bool = False) -> None:
        self.problem, self.comm = problem, problem.body.comm
        constraints, unknowns = problem.constraints, problem.unknowns
        self._map, self._bs = problem.W.dofmap.index_map, problem.W.dofmap.index_map_bs
        self._dim = problem.body.dim
        self.size = self._map.size_local * self._bs
        self.origin: FloatArray = np.zeros(self.size)
        self.displacement_dofs = unknowns.displacement_dofs
        every = np.arange(len(self.displacement_dofs), dtype=np.int32)
        self._of_displacement = Rows(every) if displacement_fixed else constraints
        super().__init__(*self._of_displacement.at(unknowns.mixed_dofs))
        local = np.arange(len(problem.u.x.array) if displacement_fixed else 0, dtype=np.int32)
        combined = constraints.nodes_combined() if self.combined else local[:0]
        if problem.w is problem.u:
            self._values, self.bcs = constraints.values, constraints.bcs
            lifted = fem.dirichletbc(self._values, combined)
        else:
            self._values = fem.Function(problem.W)
            self.bcs = [self._condition(local if displacement_fixed else constraints.dofs)]
            entries = (combined[:, None] * self._dim + np.arange(self._dim)).astype(np.int32)
            lifted = self._condition(entries.reshape(-1))
        self._lifted_bcs = [*self.bcs, lifted] if self.combined else self.bcs
        self.level = self._find_level()
        self.fixed_pressures: IndexArray = np.empty(0, dtype=np.int32)
        if self.level is not None:
            self.fixed_pressures = self.level.pinned_owned
            pinned = fem.dirichletbc(self._values, self.level.pinned)
            self.bcs, self._lifted_bcs = [*self.bcs, pinned], [*self._lifted_bcs, pinned]

    def _find_level(self) -> HydrostaticConstant | None:
        """Looks for enclosed bodies where a material is incompressible. Collective."""
        if not any(part.incompressible for part in self.problem.regions):
            return None
        level = HydrostaticConstant(self.problem)
        return level if level.bodies else None

    def balanced(self, rows: FloatArray) -> FloatArray:
        """Owned rows of a residual, those of enclosed pressures without their mean. Collective."""
        return rows if self.level is None else self.level.balanced(rows)

    def settle_pressures(self) -> bool:
        """Takes the mean out of enclosed pressures; whether any was changed. Collective."""
        return self.level is not None and self.level.settle()

    def _condition(self, dofs: IndexArray) -> fem.DirichletBC:
        """Prescribes entries of the displacement's local array in all unknowns."""
        entries = self.problem.unknowns.mixed_dofs(dofs)
        return fem.dirichletbc(self._values, np.unique(entries // self._bs))

    # --- vectors ---

    def create_vector(self) -> PETSc.Vec:
        """A distributed vector of the unknowns, without ghosts; the caller destroys it."""
        vec = PETSc.Vec().createMPI((self.size, None), bsize=self._bs, comm=self.comm)
        vec.set(0.0)
        return vec

    def ghosted_vector(self) -> la.Vector:
        """A vector of the unknowns with ghosts, as DOLFINx assembles into."""
        return la.vector(self._map, self._bs)

    def get(self, x: PETSc.Vec) -> None:
        """Copies the problem's unknowns into a vector."""
        x.array_w[:] = self.problem.w.x.array[: self.size] - self.origin

    def put(self, x: PETSc.Vec) -> None:
        """Copies a vector into the problem's unknowns, ghosts included. Collective."""
        self.problem.w.x.array[: self.size] = self.origin + x.array_r
        self.extend(self.problem.w.x.array)
        self.problem.w.x.scatter_forward()
        self.problem.unknowns.w_to_u()

    def max_displacement(self) -> float:
        """Largest length of a nodal displacement [m]. Collective."""
        nodes = self.problem.V.dofmap.index_map.size_local
        u = self.problem.u.x.array[: nodes * self._dim].reshape(-1, self._dim)
        lengths = np.linalg.norm(u, axis=1)
        return float(self.comm.allreduce(float(np.max(lengths, initial=0.0)), op=MPI.MAX))

    def max_unknown(self) -> float:
        """Largest entry of all unknowns, from `origin` [m]. Collective."""
        own = self.problem.w.x.array[: self.size] - self.origin
        return float(self.comm.allreduce(float(np.max(np.abs(own), initial=0.0)), op=MPI.MAX))

    # --- what is prescribed ---

    def differences(self, target: FloatArray | None = None) -> FloatArray:
        """Displacement minus its prescribed value [m], where and along what is prescribed, else 0.

        Args:
            target: Prescribed values as of `Constraints.targets`; None: the problem's.

        Returns:
            Owned entries of all unknowns.
        """
        g = self.problem.constraints.values.x.array if target is None else target
        result = self.constrained_part(self.problem.w.x.array[: self.size])
        given = self._of_displacement
        result[self.prescribed_dofs] -= g[given.prescribed_dofs]
        if self.skewed:
            result[self.skew_dofs] -= g[given.skew_dofs]
        return result

    def lift(
        self,
        form: BilinearForm,
        differences: FloatArray,
        out: la.Vector,
        beside: Sequence[Multiplied] = (),
    ) -> None:
        """Product of the tangent's prescribed columns and g - x, for the free rows. Collective.

        Args:
            differences: Of `differences`: x - g [m].
            out: Receives K (g - x) [N], owned entries.
            beside: What K has beside the form, such as `NodeBlocks`.
        """
        w, values = self.problem.w.x.array, self._values
        saved = values.x.array.copy()
        try:
            values.x.array[:] = w
            moved = differences.copy()
            self.extend(moved)
            values.x.array[: self.size] -= moved
            values.x.scatter_forward()
            out.array[:] = 0.0
            form.lift(out.array, self._lifted_bcs, values.x.array, w)
            out.scatter_reverse(la.InsertMode.add)
            for part in beside:
                out.array[: self.size] -= part.times(moved)
        finally:
            values.x.array[:] = saved

    def remove_constrained(self, step: PETSc.Vec) -> None:
        """Removes the constrained components of an increment of the unknowns. Not collective.

        Those of fixed pressures, too.
        """
        step.array_w[:] = self.free_part(step.array_r)
        step.array_w[self.fixed_pressures] = 0.0
