"""From forms to vectors and matrices: the only place that knows lifting and ghost updates."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
import ufl
from dolfinx import fem, la
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core.jit import compile_forms
from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.timing import stage
from dolfin_elastic.core.types import FloatArray, IndexArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.cell_stress import CellStress
from dolfin_elastic.solvers.assembly.matrix import TangentMatrix


class Assembler:
    """Residual and tangent of a problem, with its prescribed displacements.

    The residual's rows at prescribed entries are replaced by (x - g), and the columns of the
    tangent there by zero; what the replaced columns would have done is added to the residual
    (lifting).  So the first Newton step moves the boundary and the inside together, and a line
    search can shorten both.  At tilted nodes (`prescribed.tilted`) the same is done along their
    held directions: rows Q R + s (P x - N+ g), and Q K Q + s P, where s is of the size of K lest
    round-off of K drown P.  All methods are collective.

    Args:
        problem: Whose residual and tangent; its `u` is changed by every evaluation.
        extra: Terms added to the residual, for example inertia.
        extra_tangent: Their contribution to the tangent.
        still: All displacements are held where they are: only the scalar fields are unknown.

    Attributes:
        form: The compiled residual.
        matrix: The tangent; owned here.
        balance: Residual without any boundary condition: out-of-balance nodal forces [N], whose
            entries at prescribed dofs are the reactions.
        free: Norm of the free entries of the last residual [N].
        held: Norm of its prescribed entries (reactions) [N].
        pushed: Norm of the forces of springs and obstacles at the last residual [N].
        moves: Owned entries of all unknowns that are displacements, in the displacement's order.
        fixed: Owned entries of all unknowns that are prescribed.
        pressures: How many unknowns are pressures, on all ranks.
        cell: Macroscopic stress of a periodic cell, or None.
        tilted: Owned entries of the components at tilted nodes, of shape (nodes, dim).
        gap: Largest |x - g| over prescribed entries at the last residual [m].
        origin: What vectors of unknowns are counted from: zeros, or what is known of a step of a
            motion, for accelerations are differences of places and would lose their digits far out.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        extra: ufl.Form | None = None,
        extra_tangent: ufl.Form | None = None,
        still: bool = False,
    ) -> None:
        self.problem, self.comm = problem, problem.body.comm
        weak_form = problem.weak_form
        residual = weak_form.residual if extra is None else weak_form.residual + extra
        tangent = weak_form.tangent if extra_tangent is None else weak_form.tangent + extra_tangent
        forms = [residual, tangent]
        if weak_form.external is not None:
            forms.append(weak_form.external)
        forms += weak_form.restraint_works.values()
        compiled = compile_forms(self.comm, forms, problem.jit)
        self.form, self._tangent = compiled[:2]
        self._external = compiled[2] if weak_form.external is not None else None
        first = len(compiled) - len(weak_form.restraint_works)
        self._holding = dict(zip(weak_form.restraint_works, compiled[first:], strict=True))
        self._map, self._bs = problem.W.dofmap.index_map, problem.W.dofmap.index_map_bs
        self._dim = problem.body.dim
        self.size = self._map.size_local * self._bs
        self.origin: FloatArray = np.zeros(self.size)
        self.balance, self._lift = self._vector(), self._vector()
        held, places = problem.dirichlet, problem.unknowns.places
        self._held, self.fixed = held.owned, places(held.owned)
        self.moves = problem.unknowns.moves
        self._places = places(np.arange(len(problem.u.x.array), dtype=np.int32))
        self._tilted = None if still else held.tilted
        nodes = np.empty(0, np.int32) if self._tilted is None else self._tilted.nodes
        entries = (nodes[:, None] * self._dim + np.arange(self._dim)).astype(np.int32)
        self._nodes = nodes[: 0 if self._tilted is None else self._tilted.count]
        self.tilted = places(entries[: len(self._nodes)])
        if problem.w is problem.u:
            self._values, self._bcs = held.values, held.bcs
            lifted: list[fem.DirichletBC] = [fem.dirichletbc(self._values, nodes)]
        else:
            self._values = fem.Function(problem.W)
            dofs = np.arange(len(problem.u.x.array), dtype=np.int32) if still else held.dofs
            self._bcs, lifted = [self._condition(dofs)], [self._condition(entries.reshape(-1))]
        self._lifted_bcs = self._bcs if self._tilted is None else self._bcs + lifted
        if still:
            self._held, self.fixed = np.arange(len(self.moves), dtype=np.int32), self.moves
        self.cell = None if problem.cell is None else CellStress(problem)
        self.pressures = problem.unknowns.count("pressure")
        self.free = self.held = self.gap = self.pushed = 0.0
        with stage("assemble"):
            P = None if self._tilted is None else self._tilted.P[: len(self._nodes)]
            self._filled = TangentMatrix(self._tangent, None if P is None else self.tilted, P)
        self.matrix = self._filled.petsc
        self._shift: float | None = None
        self._scale = 0.0
        if problem.symmetric:
            self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self.matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)

    def _condition(self, dofs: IndexArray) -> fem.DirichletBC:
        """Holds entries of the displacement's local array in all unknowns."""
        places = self.problem.unknowns.places(dofs)
        return fem.dirichletbc(self._values, np.unique(places // self._bs))

    def _vector(self) -> la.Vector:
        return la.vector(self._map, self._bs)

    def create_vector(self) -> PETSc.Vec:
        """A distributed vector of the unknowns, without ghosts; the caller destroys it."""
        vec = PETSc.Vec().createMPI((self.size, None), bsize=self._bs, comm=self.comm)
        vec.set(0.0)
        return vec

    # --- displacement in and out ---

    def get(self, x: PETSc.Vec) -> None:
        """Copies the problem's unknowns into a vector."""
        x.array_w[:] = self.problem.w.x.array[: self.size] - self.origin

    def put(self, x: PETSc.Vec) -> None:
        """Copies a vector into the problem's unknowns, ghosts included."""
        self.problem.w.x.array[: self.size] = self.origin + x.array_r
        self.problem.w.x.scatter_forward()
        self.problem.unknowns.tell()

    # --- residual and tangent ---

    def residual(self, x: PETSc.Vec, f: PETSc.Vec, *, target: FloatArray | None = None) -> None:
        """Evaluates the residual.

        Args:
            x: Displacement.
            f: Receives the residual.
            target: Prescribed values as of `DirichletConditions.targets`; None: the problem's.
        """
        with stage("assemble"):
            self.put(x)
            self.assemble_balance()
        self.constrain(f, target=target)

    def constrain(self, f: PETSc.Vec, *, target: FloatArray | None = None) -> None:
        """The residual from `balance` as it stands and the present prescribed values."""
        with stage("assemble"):
            difference, off = self._differences(target)
            out = self.balance.array[: self.size]
            self._measure(out, difference, off)
            self._measure_holding()
            if self.gap > 0.0 and np.isfinite(self.free):
                out = out + self._lifted(difference, off)
            f.array_w[:] = out
            f.array_w[self.fixed] = difference
            if self._tilted is not None:
                free = self._tilted.free(out[self.tilted])
                f.array_w[self.tilted] = free + self._stiffness() * off

    def _stiffness(self) -> float:
        """Mean size of the tangent's diagonal at the first call, a power of two [N/m]."""
        if self._scale == 0.0:
            self._filled.unit = 0.0
            self._filled.assemble(self._bcs)
            self.forget_tangent()
            diagonal = self.matrix.getDiagonal()
            mean = float(diagonal.norm(PETSc.NormType.NORM_1)) / diagonal.getSize()
            diagonal.destroy()
            self._scale = 2.0 ** np.round(np.log2(mean)) if 0.0 < mean < np.inf else 1.0
        return self._scale

    def _differences(self, target: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """What prescribed entries, and tilted nodes along their directions, are off [m]."""
        held, x = self.problem.dirichlet, self.problem.w.x.array
        if self._tilted is None:
            wanted = held.values.x.array[self._held] if target is None else target
            return x[self.fixed] - wanted, np.zeros((0, self._dim))
        target = held.targets if target is None else target
        wanted, along = np.split(target, [len(self._held)])
        rows = self._tilted.held(x[self.tilted])
        return x[self.fixed] - wanted, rows - along.reshape(-1, self._dim)

    def norm(self) -> float:
        """Norm of the residual at the problem's unknowns. Collective."""
        x, f = self.create_vector(), self.create_vector()
        self.get(x)
        self.residual(x, f)
        norm = float(f.norm())
        x.destroy()
        f.destroy()
        return norm if np.isfinite(norm) else np.inf

    def assemble_balance(self) -> None:
        """Out-of-balance nodal forces at the problem's displacement into `balance`."""
        self.balance.array[:] = 0.0
        fem.assemble_vector(self.balance.array, self.form)
        self._add_nodal(self.balance.array, -1.0)
        self.balance.scatter_reverse(la.InsertMode.add)

    def constraint_forces(self, out: FloatArray) -> FloatArray:
        """The part of owned nodal forces that supports take up by prescribing."""
        held = np.zeros(self.size)
        held[self.fixed] = out[self.fixed]
        if self._tilted is not None:
            held[self.tilted] = self._tilted.held(out[self.tilted])
        return held

    def _measure(self, out: FloatArray, difference: FloatArray, off: FloatArray) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            held = self.constraint_forces(out)
            squares = [np.sum(np.square(out - held)), np.sum(np.square(held))]
        sums = self.comm.allreduce(np.array(squares), op=MPI.SUM)
        self.free, self.held = (float(value) for value in np.sqrt(sums))
        # NaN would come out of a maximum on some ranks only.
        difference = np.append(difference, off)
        gap = float(np.max(np.nan_to_num(np.abs(difference), nan=np.inf), initial=0.0))
        self.gap = float(self.comm.allreduce(gap, op=MPI.MAX))

    def _measure_holding(self) -> None:
        """What holds by forces is a scale of the residual, as reactions are. Collective."""
        if not self._holding:
            return
        forces = [self.nodal(form) for form in self._holding.values()]
        squares = total(self.comm, sum(float(np.sum(np.square(force))) for force in forces))
        self.pushed = float(np.sqrt(squares))

    def _lifted(self, difference: FloatArray, off: FloatArray) -> FloatArray:
        """K (g - x) of the prescribed columns, for the free rows."""
        w, values = self.problem.w.x.array, self._values
        kept = values.x.array.copy()
        try:
            values.x.array[:] = w
            values.x.array[self.fixed] -= difference
            values.x.array[self.tilted] -= off
            values.x.scatter_forward()
            self._lift.array[:] = 0.0
            fem.apply_lifting(self._lift.array, [self._tangent], [self._lifted_bcs], [w], -1.0)
            self._lift.scatter_reverse(la.InsertMode.add)
        finally:
            values.x.array[:] = kept
        return self._lift.array[: self.size]

    def tangent(self, x: PETSc.Vec, shift: float = 0.0, *, unit: float | None = None) -> None:
        """Assembles the tangent at x into `matrix`, with ones on prescribed diagonals.

        What cannot have changed is left as it is, and so is its factorisation.

        Args:
            x: The displacement.
            shift: What the extra tangent is multiplied by.
            unit: What stands along the held directions of tilted nodes, if not what fits.
        """
        with stage("assemble"):
            self.put(x)
            if self.problem.linear and shift == self._shift:
                return
            if unit is None and self._tilted is not None:
                unit = self._stiffness()
            self._filled.unit = unit or 0.0
            self._filled.assemble(self._bcs)
            self._shift = shift

    def hold(self, step: PETSc.Vec) -> None:
        """Takes from a step what supports prevent. Not collective."""
        step.array_w[self.fixed] = 0.0
        if self._tilted is not None:
            step.array_w[self.tilted] = self._tilted.free(step.array_r[self.tilted])

    def shift_diagonal(self, share: float) -> None:
        """Adds a share of the free diagonal's size to it. Collective."""
        diagonal = self.matrix.getDiagonal()
        added = share * np.abs(diagonal.array_r)
        added[self.fixed] = 0.0
        diagonal.array_w[:] += added
        self.matrix.setDiagonal(diagonal)
        diagonal.destroy()
        self.forget_tangent()

    def forget_tangent(self) -> None:
        """Says that `matrix` has been changed and is to be assembled anew."""
        self._shift = None

    def external_norm(self) -> float:
        """Norm of the applied nodal forces at the present time [N].

        A periodic cell's are those by which its neighbours hold it.
        """
        if self.cell is not None:
            return self.cell.force()
        return float(la.norm(self._applied()))

    def external_forces(self) -> FloatArray:
        """Applied nodal forces at the present time, owned entries [N]."""
        return self._applied().array[: self.size]

    def _applied(self) -> la.Vector:
        force = self._vector()
        if self._external is not None:
            fem.assemble_vector(force.array, self._external)
        self._add_nodal(force.array, 1.0)
        force.scatter_reverse(la.InsertMode.add)
        return force

    def _add_nodal(self, forces: FloatArray, sign: float) -> None:
        """Adds the loads at points and lines; the ranks' shares are still to be summed."""
        if self.problem.nodal_loads:
            forces[self._places] += sign * self.problem.nodal_loads.nodal()

    # --- what is known of the solution ---

    def reactions(self, more: FloatArray | None = None) -> dict[str, FloatArray]:
        """Force of each support and obstacle on the body [N], from `balance` as it stands.

        Args:
            more: Nodal forces to add, owned entries, for example inertia that is not in `balance`.
        """
        forces = self.balance.array[: self.size]
        if more is not None:
            forces = forces + more
        forces = forces[self.moves]
        held = self.problem.dirichlet.moving
        local = np.zeros((len(held), self._dim))
        for row, dofs in zip(local, held.values(), strict=True):
            np.add.at(row, dofs % self._dim, forces[dofs])
        if self._tilted is not None:
            leaning = self._tilted.forces(forces.reshape(-1, self._dim)[self._nodes])
            for k, label in enumerate(held):
                local[k] += leaning.get(label, 0.0)
        sums = self.comm.allreduce(local, op=MPI.SUM)
        found = dict(zip(held, sums, strict=True))
        for label, form in self._holding.items():
            found[label] = found.get(label, 0.0) + self._resultant(form)
        return found

    def nodal(self, form: fem.Form) -> FloatArray:
        """Nodal forces of a virtual work, owned entries [N]."""
        forces = self._vector()
        fem.assemble_vector(forces.array, form)
        forces.scatter_reverse(la.InsertMode.add)
        return forces.array[: self.size]

    def _resultant(self, form: fem.Form) -> FloatArray:
        """Sum of the nodal forces of a virtual work [N]."""
        nodal = self.nodal(form)[self.moves].reshape(-1, self._dim)
        return np.asarray(self.comm.allreduce(nodal.sum(axis=0), op=MPI.SUM))

    def holding_forces(self, known: Collection[str] = ()) -> FloatArray:
        """Nodal forces of all that holds by forces, but for labels that are known, owned [N]."""
        forces = np.zeros(self.size)
        for form in (form for label, form in self._holding.items() if label not in known):
            forces += self.nodal(form)
        return forces

    def max_displacement(self) -> float:
        """Largest length of a nodal displacement [m]."""
        nodes = self.problem.V.dofmap.index_map.size_local
        u = self.problem.u.x.array[: nodes * self._dim].reshape(-1, self._dim)
        lengths = np.linalg.norm(u, axis=1)
        return float(self.comm.allreduce(float(np.max(lengths, initial=0.0)), op=MPI.MAX))

    def max_unknown(self) -> float:
        """Largest entry of all unknowns, from `origin` [m]."""
        own = self.problem.w.x.array[: self.size] - self.origin
        return float(self.comm.allreduce(float(np.max(np.abs(own), initial=0.0)), op=MPI.MAX))

    def largest_unbalance(self) -> tuple[float, FloatArray]:
        """Largest free nodal force of the last residual [N] and the node's place X [m]."""
        out = self.balance.array[: self.size]
        forces = (out - self.constraint_forces(out))[self.moves]
        norms = np.linalg.norm(forces.reshape(-1, self._dim), axis=1)
        norms = np.where(np.isfinite(norms), norms, np.inf)
        node = int(np.argmax(norms)) if len(norms) else -1
        places = self.problem.unknowns.U.tabulate_dof_coordinates()
        mine = (float(norms[node]), places[node]) if node >= 0 else (-1.0, np.zeros(3))
        return max(self.comm.allgather(mine), key=lambda pair: pair[0])

    def destroy(self) -> None:
        """Frees the matrix. Collective."""
        self._filled.destroy()


def compiled(problem: Problem, forms: Sequence[ufl.Form]) -> list[fem.Form]:
    """Compiles forms with the problem's options. Collective."""
    return compile_forms(problem.body.comm, list(forms), problem.jit)


def integral(problem: Problem, form: fem.Form) -> float:
    """Value of a compiled scalar form over all ranks. Collective."""
    return float(problem.body.comm.allreduce(fem.assemble_scalar(form), op=MPI.SUM))
