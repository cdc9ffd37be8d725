"""Prescribed directions at skew nodes, in the values of an assembled matrix.

At a node with the projection P on its prescribed directions, Q = I - P, a matrix K becomes
Q K Q + P: as symmetric as before, without a penalty.  Source: the projection method for general
Dirichlet conditions, M. Ainsworth, Comput. Methods Appl. Mech. Engrg. 190 (2001) 6323.
"""

from __future__ import annotations

import numpy as np
from dolfinx import la

from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray


class SkewProjection:
    """Applies Q K Q + P to the values of a matrix in CSR form.

    Args:
        matrix: The matrix, expanded: each entry has a row and a column of its own.
        rows: Owned rows.
        places: Owned rows of each skew node's components, of shape (nodes, dim).
        P: Projections at these nodes, of shape (nodes, dim, dim).
    """

    def __init__(
        self,
        matrix: la.MatrixCSR,
        rows: int,
        places: IndexArray,
        P: FloatArray,
    ) -> None:
        self._dim = places.shape[1]
        self._P = P
        self._start, self._columns = (
            matrix.indptr[: rows + 1],
            matrix.indices[: matrix.indptr[rows]],
        )
        component, node, Q = self._columns_at_skew_nodes(matrix, places)
        self._down, self._down_at = self._row_blocks(places)
        self._diagonal, self._diagonal_from = self._own_blocks(places, component, node)
        self._right, number = self._column_blocks(rows, component, node)
        _, first, at = np.unique(number, return_index=True, return_inverse=True)
        self._right_at = at
        self._right_Q = Q[self._columns[self._right[first]]]

    def _columns_at_skew_nodes(
        self, matrix: la.MatrixCSR, places: IndexArray
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """For all columns: component (-1: at no skew node), node's number, row of Q. Collective."""
        dim, columns = self._dim, matrix.index_map(1)  # with ghosts that the space has not
        exchanged = la.vector(columns, dim + 2)
        table = exchanged.array.reshape(-1, dim + 2)
        table[:, 0] = -1.0
        table[places, 0] = np.arange(dim)
        numbers = columns.local_to_global(places[:, 0].astype(np.int32))
        table[places, 1] = numbers[:, None]
        table[places, 2:] = np.eye(dim) - self._P
        exchanged.scatter_forward()
        return table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2:]

    def _row_blocks(self, places: IndexArray) -> tuple[IntArray, IntArray]:
        """Places of values in one column and all rows of a skew node, and the node."""
        starts = self._start[places].astype(np.int64)
        lengths = np.diff(self._start)[places[:, 0]].astype(np.int64)
        of = np.repeat(np.arange(len(places)), lengths)
        offset = np.arange(len(of)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
        found = starts[of] + offset[:, None]
        if np.any(self._columns[found] != self._columns[found[:, :1]]):
            raise RuntimeError("the components of a node have not the same columns")
        return found, of

    def _own_blocks(
        self, places: IndexArray, component: IntArray, node: IntArray
    ) -> tuple[IntArray, tuple[IntArray, IntArray]]:
        """Of these, the columns of the node itself, and their (node, component)."""
        column = self._columns[self._down[:, 0]]
        own = (component[column] >= 0) & (node[column] == node[places[self._down_at, 0]])
        return self._down[own], (self._down_at[own], component[column[own]])

    def _column_blocks(
        self, rows: int, component: IntArray, node: IntArray
    ) -> tuple[IntArray, IntArray]:
        """Places of values in one row and all columns of a skew node, and the node's number."""
        at = np.flatnonzero(component[self._columns] >= 0)
        columns = self._columns[at]
        row = np.repeat(np.arange(rows), np.diff(self._start))[at]
        order = np.lexsort((component[columns], node[columns], row))
        found = at[order].reshape(-1, self._dim)
        return found, node[self._columns[found[:, 0]]]

    def apply(self, values: FloatArray, unit: float) -> None:
        """Changes the values of the owned rows in place. Not collective.

        Args:
            unit: What P is multiplied by.
        """
        Q = np.eye(self._dim) - self._P
        values[self._down] = np.einsum("mab,mb->ma", Q[self._down_at], values[self._down])
        values[self._right] = np.einsum(
            "mb,mba->ma", values[self._right], self._right_Q[self._right_at]
        )
        node, component = self._diagonal_from
        values[self._diagonal] += unit * self._P[node, :, component]
