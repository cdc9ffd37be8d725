"""Entries of sparse matrices, and values at nodes, brought to the ranks that need them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from dolfin_elastic.core.types import AnyArray, FloatArray, IndexArray, IntArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class Owners:
    """Who owns which of the numbers that ranks share. Collective to make.

    Args:
        comm: The ranks.
        first: First number that this rank owns.
    """

    def __init__(self, comm: MPI.Comm, first: int, count: int) -> None:
        self.comm, self.first, self.count = comm, first, count
        self._starts = np.array(comm.allgather(first), dtype=np.int64)
        self.size = sum(comm.allgather(count))

    def _ranks(self, numbers: IntArray) -> IntArray:
        return np.searchsorted(self._starts, numbers, side="right") - 1

    def _sent(self, ranks: IntArray, arrays: Sequence[AnyArray]) -> list[AnyArray]:
        parts = [[array[ranks == r] for array in arrays] for r in range(self.comm.size)]
        result = self.comm.alltoall(parts)
        return [np.concatenate([part[k] for part in result]) for k in range(len(arrays))]

    def by_rank(self, ids: IntArray) -> list[IntArray]:
        """Sorted numbers, by their owners."""
        ranks = self._ranks(ids)
        return [ids[ranks == r] for r in range(self.comm.size)]

    def summed(
        self, rows: IntArray, columns: IntArray, values: FloatArray, width: int | None = None
    ) -> csr_array:
        """The owned rows of a matrix from entries that ranks have of it, summed. Collective.

        Args:
            rows: Global row of each entry.
            columns: Global column.
            width: Number of columns; by default as many as rows.
        """
        from scipy.sparse import csr_array

        i, j, v = self._sent(self._ranks(rows), (rows, columns, values))
        return csr_array((v, (i - self.first, j)), shape=(self.count, width or self.size))

    def values_at(self, owned: AnyArray, numbers: IntArray) -> AnyArray:
        """Values at any global numbers. Collective.

        Args:
            owned: Values at this rank's numbers, one row each.
            numbers: Where values are asked for.
        """
        ids, back = np.unique(numbers, return_inverse=True)
        asked = self.comm.alltoall(self.by_rank(ids))
        answers = self.comm.alltoall([owned[part - self.first] for part in asked])
        return np.concatenate(answers)[back.ravel()]


class Product:
    """Products of sparse rows with vectors of which each rank owns a part. Collective to make.

    Args:
        rows: This rank's rows, columns global.
    """

    def __init__(self, owners: Owners, rows: csr_array) -> None:
        from scipy.sparse import csr_array

        self._owners, comm = owners, owners.comm
        ids, columns = np.unique(rows.indices.astype(np.int64), return_inverse=True)
        shape = (rows.shape[0], len(ids))
        self._rows = csr_array((rows.data, columns.ravel(), rows.indptr), shape=shape)
        self._asked = owners.by_rank(ids)
        self._given = [part - owners.first for part in comm.alltoall(self._asked)]

    def times(self, owned: FloatArray) -> FloatArray:
        """The rows times a vector. Collective.

        Args:
            owned: This rank's entries of the vector, or more behind them.
        """
        parts = self._owners.comm.alltoall([owned[part] for part in self._given])
        return np.asarray(self._rows @ np.concatenate(parts))

    def add_transposed(self, values: FloatArray, to: FloatArray) -> None:
        """Adds the transposed rows times a vector. Collective.

        Args:
            values: One number for each of this rank's rows.
            to: This rank's entries, which are changed.
        """
        cuts = np.cumsum([len(part) for part in self._asked])[:-1]
        parts = self._owners.comm.alltoall(np.split(self._rows.T @ values, cuts))
        for coordinates, part in zip(self._given, parts, strict=True):
            to[coordinates] += part  # the numbers of one rank are unique

    def at(self, numbers: Callable[[IndexArray], IndexArray]) -> Product:
        """The same for vectors that have their entries at other places; see `Rows`."""
        result = copy(self)
        result._given = [numbers(part) for part in self._given]
        return result
