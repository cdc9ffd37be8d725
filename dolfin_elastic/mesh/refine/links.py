"""`CellLinks`: data of cells are sent to the ranks that the cells have moved to."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.types import AnyArray, IntArray


class CellLinks:
    """Sends data of cells to the ranks that they have moved to.  Collective to make.

    Only rows that a rank needs are sent to it.

    Args:
        comm: The ranks.
        count: Cells that this rank had.
        wanted: For each cell that it has now, the global number it had: those of rank 0 first, then
            those of rank 1 ...
    """

    def __init__(self, comm: MPI.Comm, count: int, wanted: IntArray) -> None:
        self._comm = comm
        ends = np.cumsum(comm.allgather(count))
        owner = np.searchsorted(ends, wanted, side="right")
        self._order = np.argsort(owner, kind="stable")
        self._asked = np.bincount(owner, minlength=comm.size)
        self._given = np.empty_like(self._asked)
        comm.Alltoall(self._asked, self._given)
        rows = np.ascontiguousarray(wanted[self._order], dtype=np.int64)
        self._rows = np.empty(int(self._given.sum()), dtype=np.int64)
        comm.Alltoallv([rows, self._asked], [self._rows, self._given])
        self._rows -= ends[comm.rank] - count

    def __call__(self, rows: AnyArray) -> AnyArray:
        """Rows of the cells that this rank has now.  Collective.

        Args:
            rows: A row for each cell that this rank had, shape (cells before, ...), of the same
                type and width on all ranks.

        Returns:
            Shape (cells now, ...).
        """
        width = int(np.prod(rows.shape[1:], dtype=int))
        out = np.ascontiguousarray(rows[self._rows]).reshape(len(self._rows), width)
        got = np.empty((len(self._order), width), dtype=rows.dtype)
        self._comm.Alltoallv(
            [out, self._given * width, MPI._typedict[rows.dtype.char]],
            [got, self._asked * width, MPI._typedict[rows.dtype.char]],
        )
        found = np.empty_like(got)
        found[self._order] = got
        return found.reshape(len(found), *rows.shape[1:])
