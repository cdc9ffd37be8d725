"""Blocks of pairs of nodes as a matrix of all unknowns, without and with the constraints."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IntArray
from dolfin_elastic.problem.term import Blocks
from dolfin_elastic.solvers.assembly.dofs import ConstrainedDofs
from dolfin_elastic.solvers.assembly.matrix import transformation
from dolfin_elastic.solvers.petsc.c_api import room_for_entries, sum_entries
from dolfin_elastic.solvers.petsc.halo import Halo


class NodeBlocks:
    """What is added to a tangent beside its elements. Collective.

    Args:
        of: Gives the blocks at the present unknowns.

    Attributes:
        pattern: Grows whenever other pairs of nodes have blocks.
    """

    def __init__(self, dofs: ConstrainedDofs, of: Callable[[], Blocks]) -> None:
        self._dofs, self._of, self.pattern = dofs, of, 0
        self._pairs: tuple[IntArray, IntArray] | None = None
        self._matrix: PETSc.Mat | None = None
        self._constraints: PETSc.Mat | None = None
        self._free: tuple[PETSc.Mat, int] | None = None

    def assembled(self) -> PETSc.Mat:
        """The blocks at the present unknowns without the constraints; owned here. Collective."""
        blocks = self._of()
        pairs = (blocks.rows, blocks.columns)
        same = self._pairs is not None and all(map(np.array_equal, pairs, self._pairs))
        if self._matrix is None or total(self._dofs.comm, int(not same)):
            if self._matrix is not None:
                self._matrix.destroy()
            self._matrix = self._of_pattern(blocks)
            self._pairs, self.pattern = pairs, self.pattern + 1
        values, dim = blocks.values, self._dofs.problem.body.dim
        sum_entries(self._matrix, np.repeat(values, dim) if values.ndim == 1 else values)
        return self._matrix

    def _of_pattern(self, blocks: Blocks) -> PETSc.Mat:
        """A matrix with room for blocks of pairs of nodes, from which PETSc makes their sum."""
        dofs, problem, rows, columns = self._dofs, self._dofs.problem, blocks.rows, blocks.columns
        nodes, dim = problem.V.dofmap.index_map, problem.body.dim
        space, bs = problem.W.dofmap.index_map, problem.W.dofmap.index_map_bs
        first, last = nodes.local_range
        every = np.concatenate([rows, columns])
        halo = Halo(dofs.comm, last - first, np.unique(every[(every < first) | (every >= last)]))
        entries = np.empty((halo.size, dim), dtype=np.int64)
        entries[: halo.owned].reshape(-1)[:] = bs * space.local_range[0] + dofs.displacement_dofs
        halo.fill(entries)
        i, j = entries[halo.local(rows)], entries[halo.local(columns)]
        halo.destroy()
        matrix = PETSc.Mat().create(dofs.comm)
        matrix.setSizes(((dofs.size, None),) * 2)
        matrix.setBlockSize(bs)
        matrix.setType(PETSc.Mat.Type.AIJ)
        if blocks.values.ndim > 1:
            i, j = np.broadcast_arrays(i[:, :, None], j[:, None, :])
        room_for_entries(matrix, i.reshape(-1), j.reshape(-1))
        return matrix

    def free(self) -> PETSc.Mat:
        """The blocks at the present unknowns with the constraints, T^T B T; owned here.

        T has no prescribed rows: nothing is in these rows and columns then.
        """
        B = self.assembled()
        if self._constraints is None:
            moves = self._dofs.displacement_dofs
            self._constraints = transformation(
                self._dofs.problem, self._dofs, B, moves, prescribed=0.0
            )
        if self._free is not None and self._free[1] == self.pattern:
            B.ptap(self._constraints, result=self._free[0])
            return self._free[0]
        if self._free is not None:
            self._free[0].destroy()
        self._free = B.ptap(self._constraints), self.pattern
        return self._free[0]

    @property
    def last(self) -> PETSc.Mat | None:
        """What `free` has given last; None where it was never asked."""
        return None if self._free is None else self._free[0]

    def times(self, direction: FloatArray, *, transposed: bool = False) -> FloatArray:
        """Product with the blocks at the present unknowns, as if nothing were prescribed.

        Args:
            direction: Owned entries of all unknowns [m].
            transposed: Forces at the blocks' columns, as of their work on a motion.
        """
        B = self.assembled()
        x, y = B.createVecs()
        x.array_w[:] = direction
        (B.multTranspose if transposed else B.mult)(x, y)
        result = np.array(y.array_r)
        x.destroy()
        y.destroy()
        return result

    def destroy(self) -> None:
        """Frees PETSc's objects. Collective."""
        free = None if self._free is None else self._free[0]
        for matrix in (self._matrix, self._constraints, free):
            if matrix is not None:
                matrix.destroy()


def node_blocks(matrix: PETSc.Mat, dim: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Owned node, global node and values of each block of a displacement's matrix. Collective."""
    start, columns, values = matrix.getValuesCSR()
    first, length = start[:-1:dim].astype(np.int64), np.diff(start)[::dim] // dim
    nodes = np.repeat(np.arange(len(length)), length)
    within = np.arange(len(nodes)) - np.repeat(np.cumsum(length) - length, length)
    row, column = np.arange(dim)[:, None], np.arange(dim)
    begins = (first[nodes] + dim * within)[:, None, None]
    at = begins + row * (dim * length[nodes])[:, None, None] + column
    return nodes, columns[at[:, 0, 0]].astype(np.int64) // dim, values[at]
