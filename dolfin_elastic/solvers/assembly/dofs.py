"""The vector of unknowns: displacement dofs, and dofs with Dirichlet conditions."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from dolfinx import fem, la
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.matrix import BilinearForm
from dolfin_elastic.solvers.assembly.pressure_level import PressureLevel


class Multiplied(Protocol):
    """A matrix of all unknowns."""

    def times(self, direction: FloatArray) -> FloatArray:
        """Its product with owned entries of a direction [m], of the same shape. Collective."""


class ConstrainedDofs:
    """Owned dofs of a problem's unknowns, with its Dirichlet conditions. Collective to make.

    Args:
        problem: Whose unknowns; its `w` and `u` are changed by `put`.
        displacement_fixed: All displacements are prescribed: only the scalar fields are unknown.

    Attributes:
        problem: Whose unknowns.
        comm: Its ranks.
        size: Dofs that this rank owns.
        displacement_dofs: Those that belong to the displacement, in the displacement's order.
        prescribed_dofs: Those that are prescribed.
        skew: Nodes whose prescribed directions are not along the axes; None if no rank has any.
        ties: Which displacements follow others; None without ties.
        skew_dofs: All components at the owned ones of these nodes, of shape (nodes, dim).
        level: The bodies whose pressure is known up to a constant; None without any.
        fixed_pressures: Those that `level` fixes.
        bcs: DOLFINx's conditions at `prescribed_dofs` and `fixed_pressures`, ghosts included.
        origin: Offset of vectors of unknowns: zeros, or the predictor of a time step, because
            accelerations are differences of displacements and would lose digits where these are
            large; at pressures a uniform one that is an unknown of its own.
    """

    def __init__(self, problem: Problem, *, displacement_fixed: bool = False) -> None:
        self.problem, self.comm = problem, problem.body.comm
        dirichlet, unknowns = problem.dirichlet, problem.unknowns
        self._map, self._bs = problem.W.dofmap.index_map, problem.W.dofmap.index_map_bs
        self._dim = problem.body.dim
        self.size = self._map.size_local * self._bs
        self.origin: FloatArray = np.zeros(self.size)
        self.displacement_dofs = unknowns.displacement_dofs
        self._prescribed = dirichlet.owned
        self.prescribed_dofs = unknowns.mixed_dofs(dirichlet.owned)
        self.skew = None if displacement_fixed else dirichlet.skew
        nodes = np.empty(0, np.int32) if self.skew is None else self.skew.nodes
        self.ties = None if displacement_fixed else problem.ties
        entries = (nodes[:, None] * self._dim + np.arange(self._dim)).astype(np.int32)
        self.skew_dofs = unknowns.mixed_dofs(entries[: 0 if self.skew is None else self.skew.count])
        if problem.w is problem.u:
            self._values, self.bcs = dirichlet.values, dirichlet.bcs
            lifted: list[fem.DirichletBC] = [fem.dirichletbc(self._values, nodes)]
            if self.ties is not None:
                lifted.append(fem.dirichletbc(self._values, self.ties.nodes))
        else:
            self._values = fem.Function(problem.W)
            every = np.arange(len(problem.u.x.array), dtype=np.int32)
            self.bcs = [self._condition(every if displacement_fixed else dirichlet.dofs)]
            lifted = [self._condition(entries.reshape(-1))]
            if self.ties is not None:
                tied = self.ties.nodes[:, None] * self._dim + np.arange(self._dim)
                lifted.append(self._condition(tied.reshape(-1).astype(np.int32)))
        self.level = self._find_level()
        self.fixed_pressures: IndexArray = np.empty(0, dtype=np.int32)
        if self.level is not None:
            self.fixed_pressures = self.level.pinned_owned
            self.bcs = [*self.bcs, fem.dirichletbc(self._values, self.level.pinned)]
        plain = self.skew is None and self.ties is None
        self._lifted_bcs = self.bcs if plain else self.bcs + lifted
        if displacement_fixed:
            self.prescribed_dofs = self.displacement_dofs
            self._prescribed = np.arange(len(self.displacement_dofs), dtype=np.int32)

    def _find_level(self) -> PressureLevel | None:
        """Looks for enclosed bodies where a material is incompressible. Collective."""
        if not any(part.incompressible for part in self.problem.regions):
            return None
        level = PressureLevel(self.problem)
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

    # --- ties ---

    def extend(self, unknowns: FloatArray) -> None:
        """Makes tied displacements follow the others. Collective.

        Args:
            unknowns: Owned entries of all unknowns, of their rates or of a step, or more behind.
        """
        if self.ties is not None:
            u = unknowns[self.displacement_dofs]
            self.ties.extend(u)
            unknowns[self.displacement_dofs] = u

    def collect(self, forces: FloatArray) -> FloatArray:
        """Nodal forces with those on tied nodes moved to what these follow. Collective.

        Args:
            forces: Owned entries of all unknowns [N].
        """
        if self.ties is None:
            return forces
        found = forces.copy()
        found[self.displacement_dofs] = self.ties.collect(forces[self.displacement_dofs])
        return found

    # --- what is prescribed ---

    def differences(self, target: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Displacement minus its prescribed value [m], at prescribed dofs and at skew nodes.

        Args:
            target: Prescribed values as of `DirichletConditions.targets`; None: the problem's.

        Returns:
            At `prescribed_dofs`, and along the prescribed directions at `skew_dofs`, (nodes, dim).
        """
        dirichlet, x = self.problem.dirichlet, self.problem.w.x.array
        if self.skew is None:
            goal = dirichlet.values.x.array[self._prescribed] if target is None else target
            return x[self.prescribed_dofs] - goal, np.zeros((0, self._dim))
        target = dirichlet.targets if target is None else target
        goal, along = np.split(target, [len(self._prescribed)])
        rows = self.skew.constrained_part(x[self.skew_dofs])
        return x[self.prescribed_dofs] - goal, rows - along.reshape(-1, self._dim)

    def lift(
        self,
        form: BilinearForm,
        differences: tuple[FloatArray, FloatArray],
        out: la.Vector,
        blocks: Multiplied | None = None,
    ) -> None:
        """Product of the tangent's prescribed columns and g - x, for the free rows. Collective.

        Args:
            differences: Of `differences`: x - g [m].
            out: Receives K (g - x) [N], owned entries.
            blocks: What K has beside the form, such as `NodeBlocks`; None: nothing.
        """
        w, values = self.problem.w.x.array, self._values
        saved = values.x.array.copy()
        try:
            values.x.array[:] = w
            moved = np.zeros(self.size)
            moved[self.prescribed_dofs] = differences[0]
            moved[self.skew_dofs] = differences[1]
            self.extend(moved)
            values.x.array[: self.size] -= moved
            values.x.scatter_forward()
            out.array[:] = 0.0
            form.lift(out.array, self._lifted_bcs, values.x.array, w)
            out.scatter_reverse(la.InsertMode.add)
            if blocks is not None:
                out.array[: self.size] -= blocks.times(moved)
        finally:
            values.x.array[:] = saved

    def constrained_part(self, vector: FloatArray) -> FloatArray:
        """The part of owned entries that Dirichlet conditions prescribe; of forces, reactions."""
        part = np.zeros(self.size)
        part[self.prescribed_dofs] = vector[self.prescribed_dofs]
        if self.skew is not None:
            part[self.skew_dofs] = self.skew.constrained_part(vector[self.skew_dofs])
        return part

    def remove_constrained(self, step: PETSc.Vec) -> None:
        """Removes the constrained components of an increment of the unknowns. Not collective.

        Those of fixed pressures, too.
        """
        step.array_w[self.prescribed_dofs] = 0.0
        step.array_w[self.fixed_pressures] = 0.0
        if self.skew is not None:
            step.array_w[self.skew_dofs] = self.skew.free_part(step.array_r[self.skew_dofs])
