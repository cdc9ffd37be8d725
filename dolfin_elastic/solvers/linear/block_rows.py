"""Matrices of small blocks, one for each pair of nodes, distributed by rows over the ranks.

Tangents become such matrices for `aggregation` and `hierarchy`, whose loops in C know the size of
the blocks.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.jit import CFunctions, compile_c
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray, IntArray, SingleArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.assembly.symmetric.blocks import SymmetricBlocks, in_full
from dolfin_elastic.solvers.assembly.symmetric.several import Vectors
from dolfin_elastic.solvers.petsc.c_api import parts_of_aij
from dolfin_elastic.solvers.petsc.halo import Halo

PART = 100_000
"""Entries of the rows whose blocks are made at once, where a matrix has none in full: 0.8 MB, which
the second-level cache holds."""


class Interpolation:
    """A matrix of blocks of rows of owned nodes, from nodes of a coarser level.

    In single precision from the moment it is made: the coarse matrix is that of the interpolation
    which the cycle uses, to the digits of double precision.

    Args:
        start: Where each node's row begins, and the last one ends [n + 1].
        columns: Local number of the node in `halo` of each block.
        blocks: Shape (blocks, R, C), in `room_for` as many.
    """

    def __init__(
        self, start: IntArray, columns: IndexArray, blocks: SingleArray, halo: Halo
    ) -> None:
        self.start, self.columns, self.blocks, self.halo = start, columns, blocks, halo
        self.R, self.C = blocks.shape[1:]

    def destroy(self) -> None:
        """Frees PETSc's objects. Collective."""
        self.halo.destroy()


def of_width(name: str, b: Vectors) -> str:
    """The loop for one vector, shape (nodes, R), or for several, shape (nodes, R, `EIGHT`)."""
    return name if b.ndim == 2 else f"{name}_eight"


def room_for(count: int, R: int, C: int) -> SingleArray:
    """Blocks of an interpolation, behind which the loops may read. Local."""
    return np.zeros(count * R * C + 2, dtype=np.float32)[:-2].reshape(count, R, C)


def with_room(entries: AnyArray) -> AnyArray:
    """What was made as in `room_for`, in a row with what stands behind it. Local."""
    assert isinstance(entries.base, np.ndarray)
    return entries.base


class BlockRows:
    """A matrix of blocks of rows of owned nodes.

    Args:
        start: Where each node's row begins, and the last one ends [n + 1].
        columns: Local number of the node in `halo` of each block.
        blocks: Shape (blocks, R, C).

    Attributes:
        whole: It has all its blocks in `blocks`.
        symmetric: It is known to be so.
    """

    whole, symmetric = True, False

    def __init__(
        self, start: IntArray, columns: IndexArray, blocks: FloatArray, halo: Halo
    ) -> None:
        self._pattern = (start, columns)
        self.blocks, self.halo, self.rows = blocks, halo, len(start) - 1
        self.R, self.C = blocks.shape[1:]

    def pattern(self) -> tuple[IntArray, IndexArray]:
        """See `start` and `columns` of the class. Local."""
        return self._pattern

    @property
    def start(self) -> IntArray:
        """See the class."""
        return self.pattern()[0]

    @property
    def columns(self) -> IndexArray:
        """See the class."""
        return self.pattern()[1]

    def parts(self) -> Iterator[tuple[int, int, FloatArray]]:
        """First row, number of rows and their blocks, for loops over the whole matrix. Local."""
        yield 0, self.rows, self.blocks

    def times(self, x: FloatArray, loops: CFunctions) -> FloatArray:
        """The product of a square matrix, of owned nodes. Collective.

        Args:
            x: At owned nodes and ghosts.
        """
        y = np.empty((self.rows, self.R))
        matrix = (*self.pattern(), self.blocks)
        loops.call("product", self.R, self.rows, *matrix, self.halo.size, x, y)
        return y

    def diagonal(self, loops: CFunctions) -> FloatArray:
        """The diagonal blocks of a square matrix, shape (rows, R, R). Local."""
        blocks = np.zeros((self.rows, self.R, self.R))
        for first, count, part in self.parts():
            loops.call(
                *("take_diagonal", first, count, self.R, self.start, self.columns, part, blocks)
            )
        return blocks

    def with_blocks(self) -> BlockRows:
        """The same with all its blocks. Collective."""
        if self.whole:
            return self
        blocks = np.empty((self.start[-1], self.R, self.C))
        for first, count, part in self.parts():
            blocks[self.start[first] : self.start[first + count]] = part
        result = BlockRows(self.start, self.columns, blocks, self._halo_of_its_own())
        result.symmetric = self.symmetric
        return result

    def _halo_of_its_own(self) -> Halo:
        return self.halo

    def take_blocks(self) -> FloatArray:
        """Hands over the blocks, as to free them; rows, columns and halo stay."""
        blocks, self.blocks = self.blocks, np.empty((0, self.R, self.C))
        return blocks

    def destroy(self) -> None:
        """Frees PETSc's objects. Collective."""
        self.halo.destroy()


def in_single_precision(blocks: FloatArray, loops: CFunctions) -> SingleArray:
    """Blocks column by column, and room that the loops may read. Not collective.

    Args:
        blocks: Shape (blocks, R, C).
    """
    out = np.zeros(blocks.size + 2, dtype=np.float32)
    loops.call("in_single_precision", *blocks.shape, blocks, out)
    return out


def into_single_precision(blocks: FloatArray, loops: CFunctions) -> SingleArray:
    """The same, in the memory of the blocks where it is theirs alone. Not collective.

    Both at once would take half as much again.

    Args:
        blocks: Shape (blocks, R, C); lost.
    """
    if not blocks.flags.owndata:
        return in_single_precision(blocks, loops)
    loops.call("into_single_precision", *blocks.shape, blocks)
    blocks.resize((blocks.size // 2 + 1,), refcheck=False)  # with room
    return blocks.view(np.float32)


def _rooms(A: BlockRows) -> Iterator[tuple[int, int, FloatArray]]:
    """First row and number of rows of each part, and room for its blocks, the same for all."""
    most = max(1, PART * A.rows // max(1, A.start[-1] * A.R * A.C))
    ends = A.start[np.append(np.arange(0, A.rows, most), A.rows)]
    work = np.empty((int(np.diff(ends).max(initial=0)), A.R, A.C))
    for first in range(0, A.rows, most):
        count = min(most, A.rows - first)
        yield first, count, work[: A.start[first + count] - A.start[first]]


class PetscRows(BlockRows):
    """The blocks of an AIJ matrix, which are made a part at a time. Collective to make.

    All of them would take as much memory as the matrix itself.

    Args:
        matrix: Whose rows and columns of a node follow on each other; it must outlive this.
    """

    whole = False

    def __init__(self, matrix: PETSc.Mat, R: int, C: int, loops: CFunctions) -> None:
        near, far, numbers = parts_of_aij(matrix)
        first, last = (int(c) for c in matrix.getOwnershipRangeColumn())
        comm, rows, owned = matrix.comm.tompi4py(), (len(near.start) - 1) // R, (last - first) // C
        ghosts = np.unique(numbers // C).astype(np.int64)
        halo = Halo(comm, owned, ghosts)
        own = np.arange(last - first, dtype=np.int32)
        others = (owned + np.searchsorted(ghosts, numbers // C)).astype(np.int32)
        node = (len(own), own // C, len(others), others)
        component = ((own % C).astype(np.int8), (numbers % C).astype(np.int8))
        start = np.empty(rows + 1, dtype=np.int64)
        mark = np.full(halo.size, -1, dtype=np.int32)
        pattern = (near.start, near.columns, far.start, far.columns)
        loops.call("count_blocks", rows, R, *pattern, *node, halo.size, mark, start)
        self._petsc, self._loops, self._near, self._far = matrix, loops, near, far
        self._where = (*node, *component, halo.size, np.full(halo.size, -1, dtype=np.int64))
        columns = np.empty(start[-1], dtype=np.int32)
        super().__init__(start, columns, np.empty((0, R, C)), halo)
        self.symmetric = all(matrix.isSymmetricKnown())
        for _ in self.parts():  # which writes the columns
            pass

    def parts(self) -> Iterator[tuple[int, int, FloatArray]]:
        """See `BlockRows.parts`; the blocks are valid until the next ones."""
        R, C, near, far = self.R, self.C, self._near, self._far
        for first, count, blocks in _rooms(self):
            self._loops.call(
                *("fill_blocks", count, R, C, near.start[first * R :], near.columns, near.values),
                *(far.start[first * R :], far.columns, far.values, *self._where),
                *(self.start[first:], self.columns, blocks),
            )
            yield first, count, blocks

    def times(self, x: FloatArray, loops: CFunctions) -> FloatArray:
        """See `BlockRows.times`; PETSc's product."""
        right, left = self._petsc.createVecs()
        right.array_w[:] = x[: self.rows].reshape(-1)
        self._petsc.mult(right, left)
        y = np.array(left.array_r).reshape(self.rows, self.R)
        right.destroy()
        left.destroy()
        return y


class _HalfPattern(BlockRows):
    """A symmetric matrix of which the half of its blocks is there. Local to make.

    Args:
        start: Where each node's blocks begin, and the last one ends.
        columns: Local number of the node in `halo` of each block.
        blocks: Shape (blocks, R, R).
        loops: With those of `in_full`.
    """

    whole, symmetric = False, True

    def __init__(
        self,
        start: IntArray,
        columns: IndexArray,
        blocks: FloatArray,
        halo: Halo,
        loops: CFunctions,
    ) -> None:
        super().__init__(start, columns, blocks, halo)
        self._half, self._loops = (start, columns), loops
        self._full: tuple[IntArray, IndexArray, IndexArray] | None = None

    def pattern(self) -> tuple[IntArray, IndexArray]:
        """See `BlockRows.pattern`; made when it is needed, which products do not."""
        return self._in_full()[:2]

    def forget_pattern(self) -> None:
        """Frees that of rows in full. Local."""
        self._full = None

    def _in_full(self) -> tuple[IntArray, IndexArray, IndexArray]:
        if self._full is None:
            self._full = in_full(*self._half, self._loops)
        return self._full


class HalfRows(_HalfPattern):
    """A symmetric matrix by the half of its blocks, as halves.h says.

    Rows in full are made a part at a time.
    """

    def parts(self) -> Iterator[tuple[int, int, FloatArray]]:
        """See `BlockRows.parts`; the blocks are valid until the next ones."""
        pattern = (*self._in_full(), len(self.blocks), self.blocks)
        for first, count, blocks in _rooms(self):
            self._loops.call("rows_of_half", self.R, first, count, *pattern, blocks)
            yield first, count, blocks

    def diagonal(self, loops: CFunctions) -> FloatArray:
        """See `BlockRows.diagonal`."""
        blocks = np.zeros((self.rows, self.R, self.R))
        pattern = (*self._half, self.blocks)
        loops.call("take_diagonal", 0, self.rows, self.R, *pattern, blocks)
        return blocks

    def times(self, x: FloatArray, loops: CFunctions) -> FloatArray:
        """See `BlockRows.times`."""
        y = np.empty((self.rows, self.R))
        matrix = (*self._half, self.blocks, self.halo.size)
        loops.call("product_of_half", self.R, self.rows, *matrix, x, y)
        return y

    def rounded(self) -> tuple[IntArray, IndexArray, SingleArray]:
        """Where rows begin, columns, and blocks in single precision, taken over. Local."""
        self.forget_pattern()
        return (*self._half, into_single_precision(self.take_blocks(), self._loops))


class SymmetricRows(_HalfPattern):
    """The blocks of a symmetric tangent, which are made a part at a time. Collective to make.

    Args:
        half: The tangent; it must outlive this.
    """

    def __init__(self, half: SymmetricBlocks) -> None:
        blocks = np.empty((0, half.dim, half.dim))
        super().__init__(half.start, half.columns, blocks, half.halo, half.loops)
        self.half = half

    def parts(self) -> Iterator[tuple[int, int, FloatArray]]:
        """See `BlockRows.parts`; the blocks are valid until the next ones."""
        half = self.half
        pattern = (*self._in_full(), len(half.columns), half.high, half.low)
        for first, count, blocks in _rooms(self):
            half.loops.call("rows_in_full", first, count, *pattern, blocks)
            yield first, count, blocks

    def diagonal(self, loops: CFunctions) -> FloatArray:
        """See `BlockRows.diagonal`."""
        return self.half.diagonal_blocks()

    def times(self, x: FloatArray, loops: CFunctions) -> FloatArray:
        """See `BlockRows.times`, of the blocks in single precision."""
        y = np.empty((self.rows, self.R))
        self.half.times(x, y, rounded=True)
        return y

    def _halo_of_its_own(self) -> Halo:
        return Halo(self.halo.comm, self.halo.owned, self.halo.ghosts)

    def destroy(self) -> None:
        """See `BlockRows.destroy`: the halo is the tangent's."""


def interpolation_from_petsc(matrix: PETSc.Mat, R: int, C: int, loops: CFunctions) -> Interpolation:
    """An interpolation from an AIJ matrix. Collective.

    Args:
        matrix: Whose rows and columns of a node follow on each other.
    """
    A = PetscRows(matrix, R, C, loops)
    blocks = room_for(A.start[-1], R, C)
    for first, count, part in A.parts():
        blocks[A.start[first] : A.start[first + count]] = part
    return Interpolation(A.start, A.columns, blocks, A.halo)


def halved(problem: Problem, form: fem.Form, matrix: PETSc.Mat) -> PETSc.Mat:
    """A symmetric AIJ matrix by the half of its blocks, which the caller destroys. Collective.

    Args:
        problem: Whose displacement is the only unknown.
        form: Compiled, with the pattern of the matrix.
    """
    dim, blocks = problem.body.dim, SymmetricBlocks(problem, form)
    sizes = {"DIM": dim, "MODES": 3 * dim - 3}
    A = PetscRows(matrix, dim, dim, compile_c(blocks.halo.comm, "multigrid.c", sizes, problem.jit))
    nodes = np.repeat(np.arange(A.rows), np.diff(A.start))
    places = blocks.places(nodes, A.halo.globally(A.columns))
    for first, count, part in A.parts():
        blocks.add_at(places[A.start[first] : A.start[first + count]], part)
    A.destroy()
    return blocks.petsc()
