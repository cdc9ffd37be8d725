"""Matrices without the unknowns of tied surfaces: T^T K T, see `problem.ties`."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray, IndexArray, IntArray
from dolfin_elastic.problem.problem import Problem

SOFT = 1e-4
"""Diagonal of tied unknowns, which are coupled to nothing, over the mean of all.  It must not
hinder the rigid-body modes of multigrid's coarser levels, which do not know of ties."""


class TiedMatrix:
    """T^T K T of a matrix K, with a small diagonal at the tied unknowns. Collective.

    Columns of T at prescribed unknowns are left out: of an increment, which is zero there, and of
    the rows of K, which are ones there.

    Args:
        K: The matrix, of whose pattern the product is made; its values may change.
        displacement: Owned entries of K's vectors that are displacements, in their order.
        soft: The diagonal at tied unknowns, over the mean of all.

    Attributes:
        matrix: The product; owned here.
    """

    def __init__(
        self,
        problem: Problem,
        K: PETSc.Mat,
        displacement: IndexArray | IntArray,
        *,
        soft: float = SOFT,
    ) -> None:
        ties = problem.ties
        assert ties is not None
        self._K, self._soft, self._unit = K, soft, 0.0
        self._tied = np.asarray(displacement)[ties.tied]
        self.T = transformation(problem, K, displacement)
        self.matrix: PETSc.Mat = K.ptap(self.T)

    def renew(self) -> None:
        """Takes over the values of K. Collective."""
        self._K.ptap(self.T, result=self.matrix)
        diagonal = self.matrix.getDiagonal()
        if self._unit == 0.0 and self._soft:
            # The same for all states, so that differences of two matrices have zeros there.
            comm = self.matrix.comm.tompi4py()
            mean = total(comm, float(np.abs(diagonal.array_r).sum())) / diagonal.getSize()
            self._unit = self._soft * 2.0 ** np.round(np.log2(mean)) if mean > 0.0 else self._soft
        diagonal.array_w[self._tied] = self._unit
        self.matrix.setDiagonal(diagonal)
        diagonal.destroy()

    def destroy(self) -> None:
        """Frees what it owns. Collective."""
        self.matrix.destroy()
        self.T.destroy()


def transformation(
    problem: Problem, like: PETSc.Mat, displacement: IndexArray | IntArray
) -> PETSc.Mat:
    """T without what is prescribed, as a square matrix; the caller destroys it. Collective.

    Tied rows have their diagonal, with the value zero, so that products have it, too.

    Args:
        like: Square, with the same rows.
        displacement: Owned entries of its vectors that are displacements, in their order.
    """
    ties, dirichlet, dim = problem.ties, problem.dirichlet, problem.body.dim
    assert ties is not None
    dofs, rows = ties.dofs, ties.rows
    size, start = like.getLocalSize()[0], like.getOwnershipRange()[0]
    i = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr))
    j, v = rows.indices.astype(np.int64), rows.data
    # What supports leave of each component of a followed node: a row of Q = 1 - P.
    Q = np.tile(np.eye(dim), (dofs.count // dim, 1, 1))
    if (skew := dirichlet.skew) is not None:
        Q[skew.nodes[: skew.count]] -= skew.P[: skew.count]
    Q = Q.reshape(-1, dim)
    Q[dirichlet.owned] = 0.0
    left = dofs.values_at(Q, j)
    first = j - j % dim
    columns, values = (first[:, None] + np.arange(dim)).ravel(), (v[:, None] * left).ravel()
    places = dofs.values_at(start + np.asarray(displacement), columns)
    keep = values != 0.0
    tied = np.asarray(displacement)[ties.tied]
    ones = np.ones(size)
    ones[tied] = 0.0
    every = np.arange(size)
    return square(
        like,
        np.concatenate([every, tied[np.repeat(i, dim)[keep]]]),
        np.concatenate([start + every, places[keep]]),
        np.concatenate([ones, values[keep]]),
    )


def square(like: PETSc.Mat, i: IntArray, j: IntArray, v: FloatArray) -> PETSc.Mat:
    """A square matrix of entries, of which those at one place are summed. Collective.

    Args:
        like: Square, with the same rows.
        i: Owned row of each entry, from the first one.
        j: Its global column.
    """
    size = like.getLocalSize()[0]
    order = np.lexsort((j, i))
    i, j, v = i[order], j[order], v[order]
    first = np.ones(len(i), dtype=bool)
    first[1:] = (np.diff(i) != 0) | (np.diff(j) != 0)
    sums = np.add.reduceat(v, np.flatnonzero(first)) if len(v) else v
    start = np.concatenate([[0], np.cumsum(np.bincount(i[first], minlength=size))])
    made = PETSc.Mat().createAIJ(
        ((size, None), (size, None)),
        bsize=like.getBlockSize(),
        comm=like.comm,
        csr=(start.astype(PETSc.IntType), j[first].astype(PETSc.IntType), sums),
    )
    made.assemble()
    return made
