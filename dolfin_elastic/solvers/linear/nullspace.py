"""Motions that a tangent does not resist."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.assembler import Assembler


def null_combinations(assembler: Assembler, columns: FloatArray, small: float) -> FloatArray:
    """Orthonormal combinations of motions that the tangent, as it is assembled, maps to nothing.

    By the triangles of each rank's rows: products of columns would be right to half the digits.
    Collective.

    Args:
        assembler: With the tangent.
        columns: Owned entries of all unknowns, of norm 1, shape (entries, n).
        small: Stiffness, over the largest of a node, that counts as none.

    Returns:
        Shape (n, found).
    """
    matrix, comm = assembler.tangent.matrix, assembler.comm
    diagonal = matrix.getDiagonal()
    free = np.ones(assembler.size, dtype=bool)
    free[assembler.prescribed_dofs] = False
    scale = largest(comm, float(np.max(np.abs(diagonal.array_r[free]), initial=0.0))) or 1.0
    diagonal.destroy()
    images = times(matrix, columns) / scale
    images[assembler.prescribed_dofs] = columns[
        assembler.prescribed_dofs
    ]  # rows that were replaced by ones
    rows = np.vstack([images, np.zeros((images.shape[1],) * 2)])
    triangles = np.vstack(comm.allgather(np.linalg.qr(rows, mode="r")))
    _, sizes, mixes = np.linalg.svd(triangles, full_matrices=False)
    return np.asarray(mixes[sizes <= small].T)


def times(matrix: PETSc.Mat, columns: FloatArray) -> FloatArray:
    """A matrix times columns of owned entries, shape (entries, n). Collective."""
    x, y = matrix.createVecs()
    images = np.zeros_like(columns)
    for k in range(columns.shape[1]):
        x.array_w[:] = columns[:, k]
        matrix.mult(x, y)
        images[:, k] = y.array_r
    x.destroy()
    y.destroy()
    return images
