"""Smoothing where a term is stiff against means of the displacement, as contact at vertices is.

Such a term adds C = sum of (integral of psi_I N)^T s_I (integral of psi_I N)/A_I to a tangent, with
nodes N all around the vertices I of a surface.  Where s_I is large against the elements, one node
by itself can hardly move: block Jacobi smooths little, and conjugate gradients take a number of
iterations that grows with the root of s_I.  So other unknowns v are smoothed, u = T v: at vertices
of the surface the means, and at midside nodes what these differ by from the mean of their ends.
With the hats Z of linear elements at these vertices, for which psi_I is biorthogonal,

    T = (1 - Z M) (1 - E) + Z E,    M = (integral of psi_I N)/A_I,    M Z = 1,

where E picks the vertices: so T^T C T has blocks along its diagonal only, if s_I is the same matrix
at all points around a vertex.  Block Jacobi for v is the smoother T D^-1 T^T for u, with the blocks
D of the diagonal of T^T (K + C) T, in which those of the elements, K, are taken from K itself, and
at vertices times `HAT`.

Source: B. I. Wohlmuth, SIAM J. Numer. Anal. 38 (2000) 989 (dual functions); B. I. Wohlmuth & R. H.
Krause, SIAM J. Sci. Comput. 25 (2003) 324 (multigrid in such unknowns).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic.core.compat import interpolation_matrix
from dolfin_elastic.core.jit import CFunctions
from dolfin_elastic.core.parallel import largest
from dolfin_elastic.core.types import BoolArray, FloatArray, IndexArray, IntArray
from dolfin_elastic.problem.constraints.rows import Rows
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.term import Means
from dolfin_elastic.solvers.assembly.node_blocks import NodeBlocks
from dolfin_elastic.solvers.assembly.symmetric.several import Vectors
from dolfin_elastic.solvers.linear.block_rows import PetscRows
from dolfin_elastic.solvers.linear.multigrid import VERTEX, ZERO, rows_above
from dolfin_elastic.solvers.petsc.aij import from_entries

STIFF = 1.5
"""Trace of a node's block of C over that of its elements from which on means pay: there nodes by
themselves take 27 iterations, 21 without contact, and with means a solve takes a third longer."""

HAT = 1.5
"""Stiffness of a vertex with half of it at the midside nodes around it on the surface, over that of
the vertex alone; between 1.3 and 3 iterations are the same, with 1 they are a tenth more."""


class SurfaceMeans:
    """T, and D of one tangent. Collective to make.

    Args:
        T: See the module; empty in rows of nodes at which it is one.
        single: Entries of v that are means are 1, all others 0.
        blocks: What C is asked of, after each tangent.
    """

    def __init__(self, T: PETSc.Mat, single: PETSc.Vec, blocks: NodeBlocks) -> None:
        self._T, self._blocks, R = T, blocks, T.getBlockSize()
        rows = np.diff(T.getValuesCSR()[0]).reshape(-1, R)
        self._nodes = np.flatnonzero(rows.any(axis=1))
        self._stiffer = 1.0 + (HAT**0.5 - 1.0) * single.array_r.reshape(-1, R)[self._nodes]
        self._columns = _BlockDiagonal(T)
        self._inverse: FloatArray | None = None
        self._v, self._u = T.createVecs()

    def take(self, diagonal: FloatArray, loops: CFunctions) -> None:
        """Takes the present tangent over, if C is stiff in it. Collective.

        Args:
            diagonal: Its blocks at owned nodes, shape (n, R, R); they become one where T is not,
                so that block Jacobi leaves residuals there to `correct`.
        """
        C, self._inverse = self._blocks.last, None
        if C is None or C.norm() == 0.0:
            return
        R, stiffer = diagonal.shape[1], self._stiffer
        rows = PetscRows(C, R, R, loops)
        there = rows.diagonal(loops)[self._nodes]
        rows.destroy()
        K = diagonal[self._nodes] - there
        sizes = [np.trace(blocks, axis1=1, axis2=2) for blocks in (there, K)]
        if largest(C.comm.tompi4py(), float(np.max(sizes[0] / sizes[1], initial=0.0))) < STIFF:
            return
        means = self._columns.of(C, self._blocks.pattern)[self._nodes]
        self._inverse = stiffer[:, :, None] * K * stiffer[:, None, :] + means
        loops.call("invert_blocks", R, len(self._nodes), self._inverse)
        diagonal[self._nodes] = np.eye(R)

    def correct(self, x: Vectors, before: Vectors | None = None) -> None:
        """Makes of x - before, where T is not one, T D^-1 T^T (x - before). Collective.

        Args:
            x: Of owned nodes, shape (n, R).
            before: The iterate before, of the same shape; None: zeros.
        """
        if self._inverse is None:
            return
        nodes, u, v = self._nodes, self._u, self._v
        at = u.array_w.reshape(x.shape)
        at[nodes] = x[nodes] if before is None else x[nodes] - before[nodes]
        self._T.multTranspose(u, v)
        at = v.array_w.reshape(x.shape)
        at[nodes] = np.einsum("nij,nj->ni", self._inverse, at[nodes])
        self._T.mult(v, u)
        x[nodes] = u.array_r.reshape(x.shape)[nodes]
        if before is not None:
            x[nodes] += before[nodes]

    def destroy(self) -> None:
        """Frees PETSc's objects. Collective."""
        for thing in (self._columns, self._T, self._u, self._v):
            thing.destroy()


class _BlockDiagonal:
    """The diagonal blocks of T^T C T, for a tenth of the time of the whole product. Collective."""

    def __init__(self, T: PETSc.Mat) -> None:
        self._T, self._terms, self._pattern = T, T.copy(), 0
        self._csr = T.getValuesCSR()
        self._sums, self._ones = T.createVecs()
        self._ones.set(1.0)
        self._product: PETSc.Mat | None = None
        self._places: list[tuple[BoolArray, IntArray]] = []

    def of(self, C: PETSc.Mat, pattern: int) -> FloatArray:
        """At owned nodes, shape (n, R, R). Collective.

        Args:
            pattern: Another one where C has other entries than before.
        """
        same = self._product is not None and self._pattern == pattern
        if not same and self._product is not None:
            self._product.destroy()
        self._product = C.matMult(self._T, result=self._product if same else None)
        start, columns, found = self._product.getValuesCSR()
        if not same:
            self._pattern, self._places = pattern, self._find(start, columns)
        R = self._T.getBlockSize()
        result = np.empty((self._sums.getLocalSize() // R, R, R))
        begins, numbers, values = self._csr
        for c, (there, at) in enumerate(self._places):
            terms = values * np.where(there, found[at], 0.0) if len(found) else 0.0 * values
            self._terms.setValuesCSR(begins, numbers, terms)
            self._terms.assemble()
            self._terms.multTranspose(self._ones, self._sums)
            result[:, :, c] = self._sums.array_r.reshape(-1, R)
        return result

    def _find(self, start: IndexArray, columns: IndexArray) -> list[tuple[BoolArray, IntArray]]:
        """Where entries of C T stand that meet those of T, for each component of their nodes.

        Returns:
            Which of them are there, and their places.
        """
        R, (begins, numbers, _) = self._T.getBlockSize(), self._csr
        keys = _keys(start, columns)
        results = []
        for c in range(R):
            wanted = _keys(begins, numbers.astype(np.int64) // R * R + c)
            at = np.minimum(np.searchsorted(keys, wanted), max(len(keys) - 1, 0))
            there = keys[at] == wanted if len(keys) else np.zeros(len(at), dtype=bool)
            results.append((there, at))
        return results

    def destroy(self) -> None:
        """Frees PETSc's objects. Collective."""
        for thing in (self._terms, self._sums, self._ones, self._product):
            if thing is not None:
                thing.destroy()


def _keys(start: IndexArray, columns: IndexArray | IntArray) -> IntArray:
    """Numbers that rise with the rows and columns of entries."""
    row = np.repeat(np.arange(len(start) - 1, dtype=np.int64), np.diff(start))
    return (row << 32) + columns


def surface_means(
    problem: Problem, blocks: NodeBlocks, linear: fem.FunctionSpace
) -> SurfaceMeans | None:
    """Those of all terms that have means; None without any. Collective.

    Entries that are prescribed or follow others stay as they are.

    Args:
        blocks: Those of the terms, in one matrix.
        linear: Space of linear elements on the same mesh, of the displacement's components.
    """
    found = [means for term in problem.terms if (means := term.means()) is not None]
    if not found or problem.cell is not None:
        return None
    plain = interpolation_matrix(linear, problem.unknowns.U)
    hats, vertices = rows_above(plain, ZERO), rows_above(plain, VERTEX)
    every = hats.matTransposeMult(vertices)
    free, single = every.createVecs()
    rows = Rows(*problem.constraints.at(lambda entries: entries))
    free.set(1.0)
    for entries in (rows.prescribed_dofs, rows.skew_dofs.reshape(-1), rows.tied_dofs):
        free.array_w[entries] = 0.0
    others, near = single.duplicate(), single.duplicate()
    M, there = _weights(found, every, single)
    there.multTranspose(single, near)
    near.array_w[:] = free.array_r * (near.array_r > 0.0)
    single.pointwiseMult(single, free)
    others.array_w[:] = free.array_r - single.array_r
    every.diagonalScale(near, single)
    M.diagonalScale(single, others)
    M.scale(-1.0)
    _add_diagonal(M, single.array_r)
    Z = rows_above(every, ZERO)
    T = Z.matMult(M)
    used = np.diff(T.getValuesCSR()[0]).reshape(-1, problem.body.dim).any(axis=1)
    _add_diagonal(T, np.repeat(used, problem.body.dim) * (single.array_r == 0.0))
    result = SurfaceMeans(T, single, blocks)
    for thing in (plain, hats, vertices, every, free, single, others, near, M, there, Z):
        thing.destroy()
    return result


def _weights(
    found: Sequence[Means], like: PETSc.Mat, single: PETSc.Vec
) -> tuple[PETSc.Mat, PETSc.Mat]:
    """M in rows of vertices, and ones where it has entries. Collective.

    Args:
        found: Of a vertex the first one counts.
        like: Square, with the rows of the displacement.
        single: Becomes 1 at vertices.
    """
    parts, dim = [], like.getBlockSize()
    at_vertices = single.array_w.reshape(-1, dim)
    for means in found:
        each = np.diff(means.rows.indptr)
        new = np.repeat(at_vertices[means.vertices, 0] == 0.0, each)
        i, j = np.repeat(means.vertices, each)[new], means.nodes[means.rows.indices[new]]
        parts.append((i, j, means.rows.data[new]))
        at_vertices[means.vertices] = 1.0
    i, j, values = (np.concatenate(part) for part in zip(*parts, strict=True))
    i, j = ((dim * a[:, None] + np.arange(dim)).reshape(-1) for a in (i, j))
    ones = np.ones(len(i))
    M, there = (from_entries(like, i, j, v, square=True) for v in (np.repeat(values, dim), ones))
    return M, there


def _add_diagonal(matrix: PETSc.Mat, diagonal: FloatArray) -> None:
    """Adds what is not zero. Collective."""
    own = np.flatnonzero(diagonal)
    first = matrix.getOwnershipRange()[0]
    added = from_entries(matrix, own, own + first, np.asarray(diagonal[own], float), square=True)
    matrix.axpy(1.0, added, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    added.destroy()
