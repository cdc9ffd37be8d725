"""Nodes that a rank owns and those of other ranks that it needs, and what passes between them.

By PETSc's star forest (SF), with numpy arrays, for loops that are not PETSc's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray, IntArray, SingleArray


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
        self._ends = ends = np.cumsum(comm.allgather(owned))
        self.first, self.total = int(ends[comm.rank]) - owned, int(ends[-1])
        self._sf: PETSc.SF | None = None
        if comm.size > 1:
            owner = self.owners(ghosts)
            begins = np.concatenate([[0], ends])[owner]
            self._sf = _forest(comm, owned, owner, ghosts - begins)

    @property
    def size(self) -> int:
        """Nodes here, owned and of others."""
        return self.owned + len(self.ghosts)

    def local(self, numbers: IntArray) -> IndexArray:
        """Local numbers of nodes.

        Args:
            numbers: Global ones, of owned nodes and of ghosts.
        """
        own = (numbers >= self.first) & (numbers < self.first + self.owned)
        if not len(self.ghosts):
            return np.asarray(numbers - self.first, dtype=np.int32)
        order = np.argsort(self.ghosts, kind="stable")
        result = np.searchsorted(self.ghosts, numbers, sorter=order)
        others = self.owned + order[np.minimum(result, len(order) - 1)]
        return np.where(own, numbers - self.first, others).astype(np.int32)

    def owners(self, numbers: IntArray) -> IntArray:
        """Ranks that own nodes of these global numbers. Local."""
        return np.asarray(np.searchsorted(self._ends, numbers, side="right"), dtype=np.int64)

    def globally(self, nodes: IndexArray) -> IntArray:
        """Global numbers of local nodes."""
        own = nodes < self.owned
        if not len(self.ghosts):
            return np.asarray(nodes + self.first, dtype=np.int64)
        return np.where(own, nodes + self.first, self.ghosts[np.where(own, 0, nodes - self.owned)])

    def fill(self, values: FloatArray | SingleArray | IntArray) -> None:
        """Gets the values of ghosts from their owners. Collective.

        Args:
            values: Of all nodes here, first axis; the ghosts' are overwritten.
        """
        if self._sf is not None:
            _bring(self._sf, values[: self.owned], values[self.owned :])

    def collect(self, values: FloatArray | SingleArray) -> None:
        """Adds what stands at ghosts to what stands at their owners. Collective.

        Args:
            values: Of all nodes here, first axis.
        """
        if self._sf is not None:
            sums = values.astype(np.float64, copy=False)  # PETSc sums up no others
            unit, arguments = _unit(sums), (sums[self.owned :], sums[: self.owned], MPI.SUM)
            self._sf.reduceBegin(unit, *arguments)
            self._sf.reduceEnd(unit, *arguments)
            if sums is not values:
                values[: self.owned] = sums[: self.owned]

    def rows(self, start: IntArray, columns: IntArray, blocks: FloatArray | SingleArray) -> Rows:
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
        exchange = RowsOfOthers(self, start)
        rows = exchange.bring(columns), exchange.bring(blocks)
        exchange.destroy()
        return Rows(exchange.start, *rows, exchange.nodes)

    def places_at_others(self, start: IntArray) -> tuple[IntArray, IntArray, IndexArray]:
        """Where other ranks have rows for nodes of this rank. Collective.

        Args:
            start: Where the rows begin, of owned nodes and ghosts, and the last one ends.

        Returns:
            Rank of each row, first entry there and the one behind the last, and its owned node.
        """
        if self._sf is None:
            none = np.zeros((0, 2), dtype=np.int64)
            return none[:, 0], none, np.zeros(0, dtype=np.int32)
        degree = np.asarray(self._sf.computeDegree())
        rank = np.full(len(self.ghosts), self.comm.rank, dtype=np.int64)
        local = np.stack([rank, start[self.owned : -1], start[self.owned + 1 :]], axis=1)
        result = np.empty((int(degree.sum()), 3), dtype=np.int64)
        unit = _unit(result)
        self._sf.gatherBegin(unit, local, result)
        self._sf.gatherEnd(unit, local, result)
        nodes = np.repeat(np.arange(self.owned, dtype=np.int32), degree)
        return result[:, 0], result[:, 1:], nodes

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
    blocks: AnyArray
    nodes: IndexArray | None = None


def _forest(comm: MPI.Comm, roots: int, ranks: IntArray, offsets: IntArray) -> PETSc.SF:
    """A star forest whose leaves stand in a row. Collective."""
    remote = np.stack([ranks, offsets], axis=1).astype(PETSc.IntType)
    forest = PETSc.SF().create(comm)
    forest.setGraph(roots, None, remote)
    forest.setUp()
    return forest


def _unit(values: AnyArray) -> MPI.Datatype:
    basic = {"d": MPI.DOUBLE, "f": MPI.FLOAT}.get(values.dtype.char, MPI.INT64_T)
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


class RowsOfOthers:
    """Brings what other ranks have in their rows for nodes of this rank. Collective to make.

    Args:
        start: Where the rows here begin, of owned nodes and ghosts, and the last one ends.

    Attributes:
        start: Where each row that is brought begins, and the last one ends.
        nodes: Owned node of each.
    """

    def __init__(self, halo: Halo, start: IntArray) -> None:
        ranks, bounds, self.nodes = halo.places_at_others(start)
        self._forest: PETSc.SF | None = None
        self.start: IntArray = np.zeros(1, dtype=np.int64)
        if halo.comm.size > 1:
            self.start, self._forest = _entries(halo.comm, int(start[-1]), ranks, bounds)

    def bring(self, entries: AnyArray) -> AnyArray:
        """What others have. Collective.

        Args:
            entries: What stands at all entries of the rows here, first axis.
        """
        result = np.empty((self.start[-1], *entries.shape[1:]), dtype=entries.dtype)
        if self._forest is not None:
            _bring(self._forest, entries, result)
        return result

    def destroy(self) -> None:
        """Frees PETSc's object. Collective."""
        if self._forest is not None:
            self._forest.destroy()


def _entries(
    comm: MPI.Comm, roots: int, ranks: IntArray, bounds: IntArray
) -> tuple[IntArray, PETSc.SF]:
    """Where rows that stand on other ranks begin, one after the other, and how to get them.

    Collective.

    Args:
        comm: The ranks.
        roots: Entries that this rank has for others.
        ranks: Where each row is.
        bounds: First entry of each there, and the one behind the last.
    """
    lengths = bounds[:, 1] - bounds[:, 0]
    start = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    offsets = np.arange(start[-1]) + np.repeat(bounds[:, 0] - start[:-1], lengths)
    return start, _forest(comm, roots, np.repeat(ranks, lengths), offsets)


def _rows(
    comm: MPI.Comm, ranks: IntArray, bounds: IntArray, columns: IntArray, blocks: AnyArray
) -> Rows:
    """Rows that stand on other ranks. Collective.

    Args:
        comm: The ranks.
        ranks: Where each row is.
        bounds: First entry of each there, and the one behind the last.
        columns: Global column of each block that this rank has for others.
    """
    start, forest = _entries(comm, len(columns), ranks, bounds)
    result = Rows(
        start,
        np.empty(start[-1], dtype=np.int64),
        np.empty((start[-1], *blocks.shape[1:]), dtype=blocks.dtype),
    )
    _bring(forest, columns, result.columns)
    _bring(forest, blocks, result.blocks)
    forest.destroy()
    return result
