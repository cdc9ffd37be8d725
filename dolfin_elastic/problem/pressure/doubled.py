"""Spaces with a scalar field that jumps where groups of cells meet, by a map of their own.

The field is continuous inside each group: its nodes where cells of several groups meet have an
entry for each group.  Elements, kernels and forms know nothing of it, as of the periodic spaces in
`problem/constraints/periodic/dofmap.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx import cpp, fem, la

from dolfin_elastic.core.compat import adjacency, make_index_map, space_like
from dolfin_elastic.core.parallel import RankExchange
from dolfin_elastic.core.types import IndexArray, IntArray


@dataclass(frozen=True)
class DoubledSpace:
    """A mixed space one of whose fields jumps between groups of cells.

    Attributes:
        space: The space.
        new: Local entry of the plain space's map to that of this one, owned and ghost; of an entry
            of several groups that of one group.
        entries: Entries of the field in the plain space and groups of this rank's cells with them,
            shape (n, 2), sorted by entry, then by group.
        copies: Entry of this space for each row of `entries`.
    """

    space: fem.FunctionSpace
    new: IndexArray
    entries: IntArray
    copies: IndexArray

    def of_entries(self, entries: IndexArray) -> tuple[IndexArray, IntArray]:
        """What has become of entries of the field in the plain space. Not collective.

        Args:
            entries: Of the plain space, shape (n,).

        Returns:
            Entries here, and the group of each, shape (n, most groups at an entry); -1: no more.
        """
        first = np.searchsorted(self.entries[:, 0], entries, side="left")
        last = np.searchsorted(self.entries[:, 0], entries, side="right")
        rows = first[:, None] + np.arange(np.max(last - first, initial=1))
        known = rows < last[:, None]
        rows = np.where(known, rows, 0)
        shape = rows.shape
        if not len(self.entries):  # a rank without cells
            return np.full(shape, -1, dtype=np.int32), np.full(shape, -1, dtype=np.int64)
        copies = np.where(known, self.copies[rows], -1).astype(np.int32)
        return copies, np.where(known, self.entries[rows, 1], -1)


def doubled(W: fem.FunctionSpace, number: int, group: IntArray) -> DoubledSpace:
    """The space with a scalar field doubled where cells of several groups meet. Collective.

    Every copy of an entry belongs to a rank with a cell of its group, so that what is made from
    the cells of a rank holds all that the rank owns.

    Args:
        number: Of its scalar field, continuous Lagrange elements.
        group: Of each local cell, ghosts too, from 0.
    """
    pairs, imap, comm = _Pairs(W, number, group), W.dofmap.index_map, W.mesh.comm
    size, ghosts = imap.size_local, imap.num_ghosts
    # The entries of the plain space keep their order, those that are new stand behind them.
    extra = pairs.mine & ~pairs.first
    count = size + int(extra.sum())
    offset = int(comm.exscan(count) or 0)
    plain = la.vector(imap, 1, dtype=np.int64)
    plain.array[:size] = offset + np.arange(size)
    plain.scatter_forward()
    own = np.where(extra, size + np.cumsum(extra) - 1, pairs.here[:, 0])
    numbers = pairs.numbers(np.where(pairs.mine, offset + own, -1))
    theirs = ~pairs.mine
    more = theirs & (numbers != plain.array[pairs.here[:, 0]])
    index_map = make_index_map(
        comm,
        count,
        np.concatenate([plain.array[size:], numbers[more]]),
        np.concatenate([imap.owners, pairs.owner[more]]).astype(np.int32),
    )
    new = np.concatenate([np.arange(size), count + np.arange(ghosts)]).astype(np.int32)
    there = np.where(more, count + ghosts + np.cumsum(more) - 1, new[pairs.here[:, 0]])
    copies = np.where(pairs.mine, own, there).astype(np.int32)
    table = new[np.asarray(W.dofmap.list)]
    rows = np.searchsorted(pairs.key(pairs.here), pairs.key(pairs.of_cells))
    table[:, pairs.columns] = copies[rows].reshape(len(table), len(pairs.columns))
    cells, dofmap = adjacency(np.ascontiguousarray(table, dtype=np.int32)), W.dofmap
    made = cpp.fem.DofMap(dofmap.dof_layout, index_map, dofmap.index_map_bs, cells, dofmap.bs)
    space = fem.FunctionSpace(W.mesh, W.ufl_element(), space_like(W, made))
    return DoubledSpace(space, new, pairs.here, copies)


class _Pairs:
    """Entries of a field and the groups of the cells that have them. Collective to make.

    Args:
        group: Of each local cell.

    Attributes:
        columns: Of the field in the rows of W's map.
        of_cells: Pairs of all cells and their corners, row by row, shape (n, 2).
        here: Pairs of this rank's cells, each once, sorted.
        owner: Rank of each of these: that of the entry if it has such cells, else the lowest one.
        mine: Which of these this rank has.
        first: Which of these are the first ones of an entry that this rank owns.
    """

    def __init__(self, W: fem.FunctionSpace, number: int, group: IntArray) -> None:
        comm, imap = W.mesh.comm, W.dofmap.index_map
        self._groups = max(comm.allgather(int(group.max(initial=0)))) + 1
        layouts = [W.sub(k).dofmap.dof_layout for k in range(number)]
        before = sum(layout.num_dofs * layout.block_size for layout in layouts)
        field = np.asarray(W.sub(number).dofmap.list)
        self.columns = before + np.arange(field.shape[1])
        self.of_cells = np.stack(
            [field.reshape(-1).astype(np.int64), np.repeat(group, field.shape[1])], axis=1
        )
        keys = np.unique(self.key(self.of_cells))
        self.here = np.stack([keys // self._groups, keys % self._groups], axis=1)
        size, entry = imap.size_local, self.here[:, 0]
        own = entry < size
        self.first = own & np.concatenate([[True], entry[1:] != entry[:-1]])[: len(entry)]
        self._ghost = ~own
        ghost = entry[self._ghost] - size
        self._exchange = RankExchange(comm, np.asarray(imap.owners)[ghost])
        told = np.column_stack([np.asarray(imap.ghosts)[ghost], self.here[self._ghost, 1]])
        asked = self._exchange.send(np.column_stack([told, np.full(len(told), comm.rank)]))
        asked[:, 0] -= imap.local_range[0]
        self._asked = self.key(asked)
        self.owner = np.full(len(self.here), comm.rank, dtype=np.int64)
        owner = self._owners(keys[own], asked[:, 2], comm.rank)
        self.owner[self._ghost] = self._exchange.send_back(owner[:, None])[:, 0]
        self.mine = self.owner == comm.rank

    def _owners(self, known: IntArray, asking: IntArray, rank: int) -> IntArray:
        """Rank that gets each pair that others have asked for, of entries of this rank.

        Args:
            known: Keys of the pairs of this rank's cells.
            asking: Which rank has asked.
        """
        pairs, offset = np.unique(self._asked, return_inverse=True)
        lowest = np.full(len(pairs), np.iinfo(np.int64).max)
        np.minimum.at(lowest, offset, asking)
        lowest[np.isin(pairs, known)] = rank
        return np.asarray(lowest[offset])

    def key(self, pairs: IntArray) -> IntArray:
        """A number for each pair, in the order of entries and groups."""
        return np.asarray(pairs[:, 0] * self._groups + pairs[:, 1])

    def numbers(self, own: IntArray) -> IntArray:
        """The number that the owner of each of this rank's pairs has for it. Collective.

        The rank of an entry knows all of them, and tells them to those who have asked.

        Args:
            own: Numbers of this rank's own pairs, -1 at others.
        """
        local, ghost = self.mine & ~self._ghost, self._ghost
        told = self._exchange.send(own[ghost][:, None])[:, 0]
        keys = np.concatenate([self.key(self.here)[local], self._asked])
        pairs, offset = np.unique(keys, return_inverse=True)
        known = np.full(len(pairs), -1, dtype=np.int64)
        np.maximum.at(known, offset, np.concatenate([own[local], told]))
        result = own.copy()
        answer = known[offset[int(local.sum()) :]]
        result[ghost] = self._exchange.send_back(answer[:, None])[:, 0]
        return result
