"""Values of entries that several ranks have: sums over all ranks, and owners' values for ghosts."""

from __future__ import annotations

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI

import numpy as np
from dolfinx import fem, la
from dolfinx.common import IndexMap

from dolfin_elastic.core.types import AnyArray, BoolArray, FloatArray


def assembled(form: fem.Form, V: fem.FunctionSpace) -> FloatArray:
    """A compiled form of a test function at the owned entries of its space. Collective."""
    index_map, bs = V.dofmap.index_map, V.dofmap.index_map_bs
    result = la.vector(index_map, bs)
    fem.assemble_vector(result.array, form)
    result.scatter_reverse(la.InsertMode.add)
    return np.asarray(result.array[: index_map.size_local * bs])


def summed(index_map: IndexMap, entries: AnyArray, rows: AnyArray) -> FloatArray:
    """Sums of rows at local entries over all ranks, shape (local entries, columns). Collective.

    Args:
        entries: Local numbers, ghosts too, of any shape.
        rows: What is added there, of that shape or one that is spread over it, and columns.
    """
    work = la.vector(index_map, rows.shape[-1])
    table = work.array.reshape(-1, rows.shape[-1])
    spread = np.broadcast_to(rows, (*entries.shape, rows.shape[-1])).reshape(-1, rows.shape[-1])
    for column, values in zip(table.T, spread.T, strict=True):
        column[:] = np.bincount(entries.reshape(-1), values, minlength=len(table))
    work.scatter_reverse(la.InsertMode.add)
    work.scatter_forward()
    return np.array(table)


def marked(index_map: IndexMap, entries: AnyArray) -> BoolArray:
    """Whether each local entry is one of these on any rank. Collective."""
    return np.asarray(summed(index_map, entries, np.ones((1, 1)))[:, 0] > 0)


def with_ghosts(index_map: IndexMap, values: AnyArray) -> FloatArray:
    """Values of owned entries and, behind them, those of this rank's ghosts. Collective.

    Args:
        values: Shape (owned, columns).
    """
    work = la.vector(index_map, values.shape[1])
    table = work.array.reshape(-1, values.shape[1])
    table[: len(values)] = values
    work.scatter_forward()
    return np.array(table)
