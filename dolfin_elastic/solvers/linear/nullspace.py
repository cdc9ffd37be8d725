"""Motions in the null space of a tangent."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.assembler import Assembler


def null_combinations(assembler: Assembler, columns: FloatArray, small: float) -> FloatArray:
    """Combinations of given motions that lie in the null space of the assembled tangent.

    By a singular value decomposition of K times the motions, reduced to the triangular factor of
    each rank's rows: the product's Gram matrix would lose half the digits.  Collective.

    Args:
        columns: The motions: owned entries of all unknowns, of norm 1, shape (entries, n).
        small: Singular value, over the largest entry of the free diagonal, that counts as zero.

    Returns:
        Orthonormal coefficients of the motions, shape (n, found).
    """
    matrix, comm = assembler.tangent.matrix, assembler.comm
    diagonal = matrix.getDiagonal()
    free = np.ones(assembler.size, dtype=bool)
    free[assembler.prescribed_dofs] = False
    scale = largest(comm, float(np.max(np.abs(diagonal.array_r[free]), initial=0.0))) or 1.0
    diagonal.destroy()
    images = times(matrix, columns) / scale
    fixed = assembler.prescribed_dofs  # whose rows of K are the identity's
    images[fixed] = columns[fixed]
    if assembler.ties is not None:  # whose rows only keep the matrix regular
        images[assembler.displacement_dofs[assembler.ties.tied]] = 0.0
    rows = np.vstack([images, np.zeros((images.shape[1],) * 2)])
    triangles = np.vstack(comm.allgather(np.linalg.qr(rows, mode="r")))
    _, sizes, mixes = np.linalg.svd(triangles, full_matrices=False)
    return np.asarray(mixes[sizes <= small].T)


def times(matrix: PETSc.Mat, columns: FloatArray) -> FloatArray:
    """A matrix times several vectors. Collective.

    Args:
        columns: Owned entries of the vectors, shape (entries, n).

    Returns:
        Owned entries of the products, of the same shape.
    """
    x, y = matrix.createVecs()
    images = np.zeros_like(columns)
    for k in range(columns.shape[1]):
        x.array_w[:] = columns[:, k]
        matrix.mult(x, y)
        images[:, k] = y.array_r
    x.destroy()
    y.destroy()
    return images
