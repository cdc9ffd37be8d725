"""Sparse matrices of given entries."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.solvers.petsc.c_api import Compressed, parts_of_aij


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


class SumOfTwo:
    """A matrix that is the sum of two others, whose values change, but no patterns. Collective.

    PETSc looks for the place of each entry of one matrix in the other each time, which takes longer
    than the elements of a tangent do.

    Args:
        whole: AIJ, with all entries of both, and no others.
        most: AIJ, with entries in most places of the sum.
        few: AIJ, with entries in few rows, which the other one may lack.
    """

    def __init__(self, whole: PETSc.Mat, most: PETSc.Mat, few: PETSc.Mat) -> None:
        self._matrices = whole, most, few
        self._places: list[tuple[BoolArray, IntArray]] = []
        for full, first, second in zip(*map(_by_columns, self._matrices), strict=True):
            there = np.ones(len(full.columns), dtype=bool)
            more = np.diff(full.start) > np.diff(first.start)
            keys, at = _keys(full, more)
            there[at] = np.isin(keys, _keys(first, more)[0], assume_unique=True)
            some = np.diff(second.start) > 0
            keys, at = _keys(full, some)
            self._places.append((there, at[np.searchsorted(keys, _keys(second, some)[0])]))

    def renew(self) -> None:
        """Takes over the values of both. Collective."""
        for (there, at), *parts in zip(
            self._places, *map(_by_columns, self._matrices), strict=True
        ):
            out, most, few = (part.values for part in parts)
            out[:] = 0.0
            out[there] = most
            out[at] += few
        self._matrices[0].stateIncrease()
        self._matrices[0].assemble()


def _by_columns(matrix: PETSc.Mat) -> list[Compressed]:
    """Entries in owned columns, and in others by their global numbers. Collective."""
    own, others, numbers = parts_of_aij(matrix)
    return [own, Compressed(others.start, numbers[others.columns], others.values)]


def _keys(part: Compressed, rows: BoolArray) -> tuple[IntArray, IntArray]:
    """Numbers of the entries of some rows, alike in all matrices and rising; their places."""
    each = np.diff(part.start)
    at = np.flatnonzero(np.repeat(rows, each))
    row = np.repeat(np.flatnonzero(rows), each[rows])
    return (row << 32) + part.columns[at], at
