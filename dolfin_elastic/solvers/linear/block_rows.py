"""Matrices of small blocks, one for each pair of nodes, distributed by rows over the ranks.

PETSc's tangents become such matrices for `aggregation` and `multigrid_cycle`, whose loops in C
know the size of the blocks.  PETSc's star forest (SF) exchanges what belongs to nodes of others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core.jit import CFunctions
from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.solvers.petsc.c_api import parts_of_aij


class Halo:
    """Nodes that this rank owns, followed by nodes of other ranks that it needs.

    Args:
        comm: The ranks.  Collective.
        owned: How many nodes this rank owns; they are numbered through, rank by rank.
        ghosts: Global numbers of nodes of other ranks, in the order in which they stand here.

    Attributes:
        owned: As given.
        ghosts: As given.
        first: Global number of the first owned node.
        total: Nodes of all ranks.
    """

    def __init__(self, comm: MPI.Comm, owned: int, ghosts: IntArray) -> None:
        self.comm, self.owned, self.ghosts = comm, owned, ghosts
        ends = np.cumsum(comm.allgather(owned))
        self.first, self.total = int(ends[comm.rank]) - owned, int(ends[-1])
        self._sf: PETSc.SF | None = None
        if comm.size > 1:
            owner = np.searchsorted(ends, ghosts, side="right")
            begins = np.concatenate([[0], ends])[owner]
            self._sf = _forest(comm, owned, owner, ghosts - begins)

    @property
    def size(self) -> int:
        """Nodes here, owned and of others."""
        return self.owned + len(self.ghosts)

    def local(self, numbers: IntArray) -> IndexArray:
        """Local numbers of nodes.

        Args:
            numbers: Global ones, of owned nodes and of ghosts, which have to be sorted.
        """
        own = (numbers >= self.first) & (numbers < self.first + self.owned)
        others = self.owned + np.searchsorted(self.ghosts, numbers)
        return np.where(own, numbers - self.first, others).astype(np.int32)

    def globally(self, nodes: IndexArray) -> IntArray:
        """Global numbers of local nodes."""
        own = nodes < self.owned
        if not len(self.ghosts):
            return np.asarray(nodes + self.first, dtype=np.int64)
        return np.where(own, nodes + self.first, self.ghosts[np.where(own, 0, nodes - self.owned)])

    def fill(self, values: FloatArray | IntArray) -> None:
        """Gets the values of ghosts from their owners. Collective.

        Args:
            values: Of all nodes here, first axis; the ghosts' are overwritten.
        """
        if self._sf is not None:
            _bring(self._sf, values[: self.owned], values[self.owned :])

    def collect(self, values: FloatArray) -> None:
        """Adds what stands at ghosts to what stands at their owners. Collective.

        Args:
            values: Of all nodes here, first axis.
        """
        if self._sf is not None:
            unit, arguments = _unit(values), (values[self.owned :], values[: self.owned], MPI.SUM)
            self._sf.reduceBegin(unit, *arguments)
            self._sf.reduceEnd(unit, *arguments)

    def rows(self, start: IntArray, columns: IntArray, blocks: FloatArray) -> Rows:
        """The rows of ghosts, from their owners. Collective.

        Args:
            start: Where the rows of owned nodes begin, and the last one ends.
            columns: Global column of each block.
            blocks: Shape (blocks, R, C).
        """
        bounds = np.zeros((self.size, 2), dtype=np.int64)
        bounds[: self.owned, 0], bounds[: self.owned, 1] = start[:-1], start[1:]
        self.fill(bounds)
        ghosts = bounds[self.owned :]
        if self._sf is None:
            return Rows(np.zeros(1, dtype=np.int64), columns[:0], blocks[:0])
        return _rows(self.comm, self._owners(), ghosts, columns, blocks)

    def rows_of_others(self, start: IntArray, columns: IntArray, blocks: FloatArray) -> Rows:
        """The rows that other ranks have for nodes of this rank. Collective.

        Args:
            start: Where the rows begin, of owned nodes and ghosts, and the last one ends.
            columns: Global column of each block.
            blocks: Shape (blocks, R, C).

        Returns:
            Rows one after the other, with the owned node of each as `nodes`.
        """
        if self._sf is None:
            return Rows(np.zeros(1, dtype=np.int64), columns[:0], blocks[:0])
        degree = np.asarray(self._sf.computeDegree())
        rank = np.full(len(self.ghosts), self.comm.rank, dtype=np.int64)
        mine = np.stack([rank, start[self.owned : -1], start[self.owned + 1 :]], axis=1)
        found = np.empty((int(degree.sum()), 3), dtype=np.int64)
        unit = _unit(found)
        self._sf.gatherBegin(unit, mine, found)
        self._sf.gatherEnd(unit, mine, found)
        rows = _rows(self.comm, found[:, 0], found[:, 1:], columns, blocks)
        nodes = np.repeat(np.arange(self.owned, dtype=np.int32), degree)
        return Rows(rows.start, rows.columns, rows.blocks, nodes)

    def _owners(self) -> IntArray:
        assert self._sf is not None
        return np.asarray(self._sf.getGraph()[2].reshape(-1, 2)[:, 0], dtype=np.int64)

    def destroy(self) -> None:
        """Frees PETSc's object. Collective."""
        if self._sf is not None:
            self._sf.destroy()


@dataclass(frozen=True)
class Rows:
    """Rows of a matrix.

    Attributes:
        start: Where each begins, and the last one ends.
        columns: Global column of each block.
        blocks: Shape (blocks, R, C).
        nodes: Owned node of each, where they are not those of the ghosts.
    """

    start: IntArray
    columns: IntArray
    blocks: FloatArray
    nodes: IndexArray | None = None


def _forest(comm: MPI.Comm, roots: int, ranks: IntArray, places: IntArray) -> PETSc.SF:
    """A star forest whose leaves stand in a row. Collective."""
    remote = np.stack([ranks, places], axis=1).astype(PETSc.IntType)
    forest = PETSc.SF().create(comm)
    forest.setGraph(roots, None, remote)
    forest.setUp()
    return forest


def _unit(values: AnyArray) -> MPI.Datatype:
    basic = MPI.DOUBLE if values.dtype == np.float64 else MPI.INT64_T
    width = int(np.prod(values.shape[1:]))
    return basic if width == 1 else _contiguous(basic, width)


_UNITS: dict[tuple[str, int], MPI.Datatype] = {}


def _contiguous(basic: MPI.Datatype, width: int) -> MPI.Datatype:
    key = (basic.Get_name(), width)
    if key not in _UNITS:
        _UNITS[key] = basic.Create_contiguous(width).Commit()
    return _UNITS[key]


def _bring(forest: PETSc.SF, roots: AnyArray, leaves: AnyArray) -> None:
    """Copies entries of roots to their leaves. Collective."""
    unit = _unit(roots)
    forest.bcastBegin(unit, roots, leaves, MPI.REPLACE)
    forest.bcastEnd(unit, roots, leaves, MPI.REPLACE)


def _rows(
    comm: MPI.Comm, ranks: IntArray, bounds: IntArray, columns: IntArray, blocks: FloatArray
) -> Rows:
    """Rows that stand on other ranks. Collective.

    Args:
        comm: The ranks.
        ranks: Where each row is.
        bounds: First entry of each there, and the one behind the last.
        columns: Global column of each block that this rank has for others.
        blocks: These.
    """
    lengths = bounds[:, 1] - bounds[:, 0]
    start = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    places = np.arange(start[-1]) + np.repeat(bounds[:, 0] - start[:-1], lengths)
    forest = _forest(comm, len(columns), np.repeat(ranks, lengths), places)
    found = Rows(
        start,
        np.empty(len(places), dtype=np.int64),
        np.empty((len(places), *blocks.shape[1:])),
    )
    _bring(forest, columns, found.columns)
    _bring(forest, blocks, found.blocks)
    forest.destroy()
    return found


PART = 8192
"""Rows of nodes whose blocks are made at once, where a matrix has none of its own."""


class BlockRows:
    """A matrix of blocks of rows of owned nodes.

    Args:
        start: Where each node's row begins, and the last one ends [n + 1].
        columns: Local number of the node in `halo` of each block.
        blocks: Shape (blocks, R, C).
        halo: Nodes of its columns.

    Attributes:
        whole: It has all its blocks in `blocks`.
    """

    whole = True

    def __init__(
        self, start: IntArray, columns: IndexArray, blocks: FloatArray, halo: Halo
    ) -> None:
        self.start, self.columns, self.blocks, self.halo = start, columns, blocks, halo
        self.rows = len(start) - 1
        self.R, self.C = blocks.shape[1:]

    def parts(self) -> Iterator[tuple[int, int, FloatArray]]:
        """First row, number of rows and their blocks, for loops over the whole matrix. Local."""
        yield 0, self.rows, self.blocks

    def times(self, x: FloatArray, loops: CFunctions) -> FloatArray:
        """The product of a square matrix, of owned nodes. Collective.

        Args:
            x: At owned nodes and ghosts.
            loops: Those of `block_loops`.
        """
        y = np.empty((self.rows, self.R))
        loops.call("product", self.R, self.rows, self.start, self.columns, self.blocks, x, y)
        return y

    def with_blocks(self) -> BlockRows:
        """The same with all its blocks. Local."""
        return self

    def take_blocks(self) -> FloatArray:
        """Hands over the blocks, as to free them; rows, columns and halo stay."""
        blocks, self.blocks = self.blocks, np.empty((0, self.R, self.C))
        return blocks

    def destroy(self) -> None:
        """Frees PETSc's objects. Collective."""
        self.halo.destroy()


class PetscRows(BlockRows):
    """The blocks of an AIJ matrix, which are made a part at a time. Collective to make.

    All of them would take as much memory as the matrix itself.

    Args:
        matrix: Whose rows and columns of a node follow on each other; it must outlive this.
        R: Rows of a node.
        C: Columns of a node.
        loops: Those of `block_loops`.
    """

    whole = False

    def __init__(self, matrix: PETSc.Mat, R: int, C: int, loops: CFunctions) -> None:
        near, far, numbers = parts_of_aij(matrix)
        first, last = (int(c) for c in matrix.getOwnershipRangeColumn())
        comm, rows, owned = matrix.comm.tompi4py(), (len(near.start) - 1) // R, (last - first) // C
        ghosts = np.unique(numbers // C).astype(np.int64)
        halo = Halo(comm, owned, ghosts)
        own = np.arange(last - first, dtype=np.int32)
        node = (own // C, (owned + np.searchsorted(ghosts, numbers // C)).astype(np.int32))
        component = ((own % C).astype(np.int8), (numbers % C).astype(np.int8))
        start = np.empty(rows + 1, dtype=np.int64)
        mark = np.full(halo.size, -1, dtype=np.int32)
        pattern = (near.start, near.columns, far.start, far.columns)
        loops.call("count_blocks", rows, R, *pattern, *node, mark, start)
        self._petsc, self._loops, self._near, self._far = matrix, loops, near, far
        self._where = (*node, *component, np.full(halo.size, -1, dtype=np.int64))
        columns = np.empty(start[-1], dtype=np.int32)
        super().__init__(start, columns, np.empty((0, R, C)), halo)
        for _ in self.parts():  # which writes the columns
            pass

    def parts(self) -> Iterator[tuple[int, int, FloatArray]]:
        """See `BlockRows.parts`; the blocks are valid until the next ones."""
        R, C, near, far = self.R, self.C, self._near, self._far
        ends = self.start[np.append(np.arange(0, self.rows, PART), self.rows)]
        work = np.empty((int(np.diff(ends).max(initial=0)), R, C))
        for first in range(0, self.rows, PART):
            count = min(PART, self.rows - first)
            blocks = work[: self.start[first + count] - self.start[first]]
            self._loops.call(
                *("fill_blocks", count, R, C, near.start[first * R :], near.columns, near.values),
                *(far.start[first * R :], far.columns, far.values, *self._where),
                *(self.start[first:], self.columns, blocks),
            )
            yield first, count, blocks

    def with_blocks(self) -> BlockRows:
        """See `BlockRows.with_blocks`."""
        blocks = np.empty((self.start[-1], self.R, self.C))
        for first, count, part in self.parts():
            blocks[self.start[first] : self.start[first + count]] = part
        return BlockRows(self.start, self.columns, blocks, self.halo)

    def times(self, x: FloatArray, loops: CFunctions) -> FloatArray:
        """See `BlockRows.times`; PETSc's product."""
        right, left = self._petsc.createVecs()
        right.array_w[:] = x[: self.rows].reshape(-1)
        self._petsc.mult(right, left)
        y = np.array(left.array_r).reshape(self.rows, self.R)
        right.destroy()
        left.destroy()
        return y


def from_petsc(matrix: PETSc.Mat, R: int, C: int, loops: CFunctions) -> BlockRows:
    """The blocks of an AIJ matrix, all of them at once. Collective.

    Args:
        matrix: Whose rows and columns of a node follow on each other.
        R: Rows of a node.
        C: Columns of a node.
        loops: Those of `block_loops`.
    """
    return PetscRows(matrix, R, C, loops).with_blocks()
