"""Sparse matrices of given entries."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray


def from_entries(
    like: PETSc.Mat,
    rows: IndexArray | IntArray,
    columns: IndexArray | IntArray,
    values: FloatArray,
    *,
    square: bool = False,
) -> PETSc.Mat:
    """A matrix of given entries. Collective.

    Args:
        like: Has its communicator, its rows, its block sizes, and, unless `square`, its columns.
        rows: Owned rows, counted from this rank's first.
        columns: Global columns.
        square: It has as many columns as rows.
    """
    (size, _), (width, _) = like.getSizes()
    bs = like.getBlockSizes()
    sizes = ((size, None), (size if square else width, None))
    return aij(like.comm, sizes, (bs[0], bs[0] if square else bs[1]), (rows, columns, values))


def aij(
    comm: MPI.Comm | PETSc.Comm,
    sizes: tuple[tuple[int, None], tuple[int, None]],
    bs: tuple[int, int],
    entries: tuple[IndexArray | IntArray, IndexArray | IntArray, FloatArray],
) -> PETSc.Mat:
    """An AIJ matrix of given entries. Collective.

    Args:
        comm: The ranks.
        sizes: Owned rows and columns, as PETSc takes them.
        bs: Sizes of blocks of rows and columns.
        entries: Rows, counted from this rank's first, global columns, and values; none is there
            twice.
    """
    rows, columns, values = entries
    by_row = np.argsort(rows, kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=sizes[0][0]))])
    matrix = PETSc.Mat().createAIJ(
        sizes,
        bsize=bs,
        comm=comm,
        csr=(
            start.astype(PETSc.IntType),
            columns[by_row].astype(PETSc.IntType),
            values[by_row],
        ),
    )
    matrix.assemble()
    return matrix
