"""A global ordering of degrees of freedom that does not depend on the number of ranks.

DOLFINx numbers dofs rank by rank.  But a cell keeps its number in the input mesh
(`original_cell_index`), and the dofs of a cell stand in the element's order: so the smallest
original number of a cell with the dof, and the dof's position in that cell, identify it.  Sorted by
this key, values can be written on some ranks and read on others.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from dolfin_elastic.core.parallel import RankExchange
from dolfin_elastic.core.types import AnyArray, IntArray
from dolfin_elastic.results.hdf5 import Rows

_NONE = np.iinfo(np.int64).max


class DofOrdering:
    """The ordering of a space's nodes (blocks of dofs), in equal runs over the ranks.

    The constructor is collective.

    Args:
        V: Space of Lagrange elements, continuous or not, also mixed or periodic.

    Attributes:
        first: Number of the first node in this rank's run.
        count: Number of nodes on all ranks.
        mine: Number of nodes in this rank's run.
    """

    def __init__(self, V: fem.FunctionSpace) -> None:
        comm, dofmap, topology = V.mesh.comm, V.dofmap, V.mesh.topology
        cells = topology.index_map(topology.dim)
        keys = _dof_keys(V, dofmap.list[: cells.size_local])
        width = dofmap.list.shape[1]
        share = max(cells.size_global, 1)
        self._exchange = RankExchange(comm, keys // width * comm.size // share)
        here = self._exchange.send(keys[:, None])[:, 0]
        self._places = np.argsort(here)
        self.mine = len(here)
        self.first = int(comm.exscan(self.mine) or 0)
        self.count = int(dofmap.index_map.size_global)
        self._columns = int(dofmap.index_map_bs)

    def rows(self, function: fem.Function) -> Rows:
        """Values of a function in this rank's run. Collective."""
        size = function.function_space.dofmap.index_map.size_local
        own = function.x.array.reshape(-1, self._columns)[:size]
        return Rows(self._exchange.send(own)[self._places], self.first, self.count)

    def fill(self, function: fem.Function, rows: AnyArray) -> None:
        """Sets the values of a function, ghosts too. Collective.

        Args:
            rows: Values in this rank's run, shape (mine, block size).
        """
        arrived = np.empty_like(rows)
        arrived[self._places] = rows
        own = self._exchange.send_back(arrived)
        function.x.array[: own.size] = own.reshape(-1)
        function.x.scatter_forward()


def node_numbers(V: fem.FunctionSpace) -> IntArray:
    """Number of each local node in the ordering, ghosts too. Collective."""
    ordering, numbers = DofOrdering(V), fem.Function(V)
    size = V.dofmap.index_map_bs
    run = np.arange(ordering.first, ordering.first + ordering.mine, dtype=np.float64)
    ordering.fill(numbers, np.repeat(run[:, None], size, axis=1))
    return np.asarray(numbers.x.array[::size]).astype(np.int64)


def _dof_keys(V: fem.FunctionSpace, cells: AnyArray) -> IntArray:
    """Key of each owned node: original number of its first cell times width plus position.

    Collective.

    Args:
        cells: Local nodes of this rank's owned cells, shape (cells, width).
    """
    imap, original = V.dofmap.index_map, V.mesh.topology.original_cell_index
    width = cells.shape[1]
    keys = np.full(imap.size_local + imap.num_ghosts, _NONE, dtype=np.int64)
    first = np.asarray(original[: len(cells)], dtype=np.int64)[:, None] * width
    np.minimum.at(keys, cells, first + np.arange(width))
    # The first cell of a node may be on another rank, which has the node as a ghost.
    exchange = RankExchange(V.mesh.comm, np.asarray(imap.owners))
    result = exchange.send(np.column_stack([imap.ghosts, keys[imap.size_local :]]))
    np.minimum.at(keys, result[:, 0] - imap.local_range[0], result[:, 1])
    return keys[: imap.size_local]
