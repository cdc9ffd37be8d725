"""Values of a space in an order that is the mesh's own, on whatever ranks it is spread.

A rank numbers its unknowns as it likes.  But cells keep the number that the mesh gave them, and
within a cell the places of unknowns are in the element's order; so the first cell that knows an
unknown, and its place there, name it for ever.  Sorted by these names, values can be written on
some ranks and read on others.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic.core.types import AnyArray, IntArray
from dolfin_elastic.results.hdf5 import Rows

_NONE = np.iinfo(np.int64).max


class RankExchange:
    """Rows that go to other ranks, and the way back. Collective to make.

    Args:
        comm: The ranks.
        to: Rank that each row of this one goes to.
    """

    def __init__(self, comm: MPI.Comm, to: AnyArray) -> None:
        self._comm = comm
        self._order = np.argsort(to, kind="stable")
        self._sent = np.bincount(to, minlength=comm.size).astype(np.int64)
        self._got = np.empty_like(self._sent)
        comm.Alltoall(self._sent, self._got)

    @property
    def arriving(self) -> int:
        """Rows that this rank gets."""
        return int(self._got.sum())

    def there(self, rows: AnyArray) -> AnyArray:
        """The rows that arrive here, those of rank 0 first. Collective."""
        return self._moved(np.ascontiguousarray(rows[self._order]), self._sent, self._got)

    def back(self, rows: AnyArray) -> AnyArray:
        """What has arrived as it was before it was sent. Collective."""
        found = self._moved(np.ascontiguousarray(rows), self._got, self._sent)
        put = np.empty_like(found)
        put[self._order] = found
        return put

    def _moved(self, rows: AnyArray, sent: IntArray, got: IntArray) -> AnyArray:
        columns = rows.shape[1]
        found = np.empty((int(got.sum()), columns), dtype=rows.dtype)
        given = [rows, (sent * columns).tolist()]
        self._comm.Alltoallv(given, [found, (got * columns).tolist()])
        return found


class DofOrdering:
    """The unknowns of a space, one after the other as the mesh names them. Collective to make.

    Each rank keeps one run of them, whatever it owns of the mesh.

    Args:
        V: Space of Lagrange or piecewise constant elements, mixed or with merged nodes as well.

    Attributes:
        first: Number of this rank's first one.
        count: How many there are on all ranks.
        mine: How many of them this rank keeps.
    """

    def __init__(self, V: fem.FunctionSpace) -> None:
        comm, dofmap, topology = V.mesh.comm, V.dofmap, V.mesh.topology
        cells = topology.index_map(topology.dim)
        names = _names(V, dofmap.list[: cells.size_local])
        width = dofmap.list.shape[1]
        share = max(cells.size_global, 1)
        self._post = RankExchange(comm, names // width * comm.size // share)
        here = self._post.there(names[:, None])[:, 0]
        self._places = np.argsort(here)
        self.mine = len(here)
        self.first = int(comm.exscan(self.mine) or 0)
        self.count = int(dofmap.index_map.size_global)
        self._columns = int(dofmap.index_map_bs)

    def rows(self, function: fem.Function) -> Rows:
        """This rank's run of a function's values. Collective."""
        size = function.function_space.dofmap.index_map.size_local
        own = function.x.array.reshape(-1, self._columns)[:size]
        return Rows(self._post.there(own)[self._places], self.first, self.count)

    def fill(self, function: fem.Function, rows: AnyArray) -> None:
        """Gives a function the values of such a run, ghosts too. Collective."""
        arrived = np.empty_like(rows)
        arrived[self._places] = rows
        own = self._post.back(arrived)
        function.x.array[: own.size] = own.reshape(-1)
        function.x.scatter_forward()


def _names(V: fem.FunctionSpace, cells: AnyArray) -> IntArray:
    """What each owned unknown (node, if several share it) is called. Collective.

    Args:
        V: The space.
        cells: Local unknowns of this rank's owned cells.
    """
    imap, original = V.dofmap.index_map, V.mesh.topology.original_cell_index
    width = cells.shape[1]
    names = np.full(imap.size_local + imap.num_ghosts, _NONE, dtype=np.int64)
    first = np.asarray(original[: len(cells)], dtype=np.int64)[:, None] * width
    np.minimum.at(names, cells, first + np.arange(width))
    # Owners learn of cells on other ranks.
    post = RankExchange(V.mesh.comm, np.asarray(imap.owners))
    told = post.there(np.column_stack([imap.ghosts, names[imap.size_local :]]))
    np.minimum.at(names, told[:, 0] - imap.local_range[0], told[:, 1])
    return names[: imap.size_local]
