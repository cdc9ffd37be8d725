"""The consistent mass, one number for each pair of nodes, and what inertia adds in motion.

Inertia is the same in all directions: M_ia,jb = m_ij delta_ab with the integral of density N_i N_j,
a ninth of the block of a tangent in three dimensions.  It never changes: assembled once, it gives
inertia forces, momenta, energies, lumped masses, and its part of tangents.  Source: T. J. R.
Hughes, The Finite Element Method (2000), (7.2.12).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import ufl
from dolfinx import fem, la
from numpy.typing import NDArray

from dolfin_elastic.core.jit import compile_c, compile_forms
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.term import Blocks
from dolfin_elastic.solvers.assembly.symmetric.blocks import SymmetricBlocks
from dolfin_elastic.solvers.assembly.symmetric.several import EIGHT, by_eights


class ScalarMass:
    """The mass matrix of a displacement, of bodies and of what is mounted on them.

    As with a form, a rank has what its own cells give, of owned nodes and ghosts: the whole is the
    sum over the ranks.  Collective to make.

    Attributes:
        start: Where the row of each node here begins, and the last one ends.
        columns: Nodes j >= i of row i, local numbers, sorted.
        values: m_ij [kg]; over the angle of 1 rad of a body of revolution.

    Raises:
        InputError: A material has no density.
    """

    def __init__(self, problem: Problem) -> None:
        self._map, self._dim, comm = problem.V.dofmap.index_map, problem.body.dim, problem.body.comm
        S = fem.functionspace(problem.body.mesh, ("Lagrange", problem.degree))
        form = problem.weak_form.inertia(ufl.TrialFunction(S), ufl.TestFunction(S))
        matrix = fem.assemble_matrix(compile_forms(comm, [form], problem.jit)[0])
        nodes = self._map.size_local + self._map.num_ghosts
        number = np.zeros(nodes, dtype=np.int64)  # in V, which may be a part of a mixed space
        number[S.dofmap.list] = problem.V.dofmap.list
        here = matrix.data != 0.0  # the pattern has what only the cells of other ranks give, too
        row = number[np.repeat(np.arange(nodes), np.diff(matrix.indptr))[here]]
        column = number[matrix.indices[here]]
        half = np.flatnonzero(column >= row)
        half = half[np.argsort(row[half] * nodes + column[half], kind="stable")]
        self.columns: IndexArray = column[half].astype(np.int32)
        self.values: FloatArray = matrix.data[here][half]
        self.start: IntArray = np.append(0, np.cumsum(np.bincount(row[half], minlength=nodes)))
        self._loops = compile_c(comm, "symmetric.c", {"DIM": self._dim}, problem.jit)
        self._rows = (nodes, self.start, self.columns, self.values)
        self._eight: list[la.Vector] = []

    # --- of all ranks ---

    def times(self, x: FloatArray) -> FloatArray:
        """M x, owned entries. Collective.

        Args:
            x: Owned entries of a displacement, velocity or acceleration.
        """
        whole, out = (la.vector(self._map, self._dim) for _ in range(2))
        whole.array[: len(x)] = x
        whole.scatter_forward()
        self.add_product(whole.array, out.array)
        return self._summed(out)

    def times_several(self, vectors: FloatArray, images: FloatArray) -> None:
        """Overwrites images by M times vectors, one below the other, as in `times`. Collective."""
        if not self._eight:
            self._eight = [la.vector(self._map, self._dim * EIGHT) for _ in range(2)]
        x, y = self._eight

        def times() -> FloatArray:
            x.scatter_forward()
            y.array[:] = 0.0
            self._loops.call("add_mass_product_eight", *self._rows, x.array, y.array)
            y.scatter_reverse(la.InsertMode.add)
            return np.asarray(y.array)

        by_eights(vectors, images, x.array, times, self._loops)

    def diagonal(self) -> FloatArray:
        """Its diagonal, owned entries [kg]. Collective."""
        out = la.vector(self._map, self._dim)
        row = np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))
        whole = row == self.columns
        out.array.reshape(-1, self._dim)[row[whole]] = self.values[whole, None]
        return self._summed(out)

    def _summed(self, out: la.Vector) -> FloatArray:
        out.scatter_reverse(la.InsertMode.add)
        return np.asarray(out.array[: self._map.size_local * self._dim])

    # --- of this rank's cells ---

    def add_product(self, x: FloatArray, out: FloatArray) -> None:
        """Adds M x. Local.

        Args:
            x: Entries of a displacement, velocity or acceleration here, ghosts too.
            out: Receives the sum, before the ranks are summed.
        """
        self._loops.call("add_mass_product", *self._rows, x, out)

    def add_to_half(self, blocks: SymmetricBlocks, factor: float, fixed: NDArray[np.int8]) -> None:
        """Adds a multiple to half of a tangent. Local.

        Args:
            blocks: Of the same displacement; those of rows of other ranks are not yet sent there.
            fixed: 1 at entries here whose rows and columns are left as they are.
        """
        far = blocks.far
        half = (blocks.halo.owned, blocks.start, blocks.columns, blocks.high, blocks.low)
        others = (len(far.start) - 1, far.start, far.columns, far.blocks)
        self._add("add_mass_to_half", factor, fixed, *half, *others)

    def add_to_assembled(
        self, blocks: SymmetricBlocks, factor: float, fixed: NDArray[np.int8]
    ) -> None:
        """The same where those of rows of other ranks were sent there before. Collective."""
        blocks.far.blocks[:] = 0.0
        self.add_to_half(blocks, factor, fixed)
        blocks.far.collect()
        blocks.version += 1

    def add_to_rows(
        self, matrix: la.MatrixCSR, factor: float, fixed: NDArray[np.int8], entries: IndexArray
    ) -> None:
        """Adds a multiple to a tangent by its entries. Local.

        Args:
            matrix: Of all unknowns; rows of ghosts are not yet sent to their owners.
            fixed: 1 at unknowns here whose rows and columns are left as they are.
            entries: Those of the displacement's entries here among all unknowns.
        """
        begins = matrix.indptr.astype(np.int64)
        numbers = np.ascontiguousarray(matrix.indices, dtype=np.int32)
        rows = (len(begins) - 1, fixed, begins, numbers, matrix.data)
        self._add("add_mass_to_rows", factor, entries, *rows)

    def _add(self, loop: str, factor: float, *arguments: int | NDArray[np.generic]) -> None:
        if self._loops.call(loop, *self._rows, np.array([factor]), *arguments) >= 0:
            raise RuntimeError("the tangent has no entries for the mass")

    def blocks(self) -> Blocks:
        """The same as blocks of pairs of nodes, numbered over all ranks. Local."""
        row = np.repeat(np.arange(len(self.start) - 1, dtype=np.int32), np.diff(self.start))
        two = row != self.columns
        pairs = np.append(row, self.columns[two]), np.append(self.columns, row[two])
        rows, columns = (self._map.local_to_global(one) for one in pairs)
        m = np.append(self.values, self.values[two])
        return Blocks(rows, columns, m)


class InertiaForces:
    """What inertia, and a drag that is proportional to it, add to residual and tangent.

    Args:
        factor: Gives the multiple of the mass in the tangent [1/s^2].

    Attributes:
        mass: As given.
        rates: The acceleration, with that of the drag [m/s^2].
    """

    def __init__(self, problem: Problem, mass: ScalarMass, factor: Callable[[], float]) -> None:
        self.mass, self._factor = mass, factor
        size = len(problem.u.x.array)
        self._entries = problem.unknowns.mixed_dofs(np.arange(size, dtype=np.int32))
        self._own = problem.unknowns.displacement_dofs
        self.rates = fem.Function(problem.V)

    def add_forces(self, forces: FloatArray) -> None:
        """Adds M times the rates. Local.

        Args:
            forces: Entries of all unknowns here, before the ranks are summed [N].
        """
        rows = np.zeros(len(self._entries))
        self.mass.add_product(self.rates.x.array, rows)
        forces[self._entries] += rows

    def add_to_half(self, blocks: SymmetricBlocks, fixed: NDArray[np.int8]) -> None:
        """See `ScalarMass.add_to_half`."""
        self.mass.add_to_half(blocks, self._factor(), fixed)

    def add_to_rows(self, matrix: la.MatrixCSR, fixed: NDArray[np.int8]) -> None:
        """See `ScalarMass.add_to_rows`."""
        self.mass.add_to_rows(matrix, self._factor(), fixed, self._entries)

    def times(self, direction: FloatArray) -> FloatArray:
        """Product of its part of the tangent, as if nothing were prescribed. Collective.

        Args:
            direction: Owned entries of all unknowns [m].
        """
        out = np.zeros(len(direction))
        out[self._own] = self._factor() * self.mass.times(direction[self._own])
        return out
