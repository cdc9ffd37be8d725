"""The lowest eigenvalues of large symmetric pencils without factors, by LOBPCG.

Rayleigh and Ritz in the span of all approximate vectors X, their preconditioned residuals W and the
last changes P: conjugate gradients for the Rayleigh quotient (A. Knyazev, SIAM J. Sci. Comput. 23
(2001) 517), with a basis that stays orthogonal (J. Duersch, M. Shao, C. Yang and M. Gu, SIAM J.
Sci. Comput. 40 (2018) C655).  No linear system is solved: a step costs one cycle of multigrid for
each vector, and ranks exchange products of vectors only.

An eigenvalue lies within |R| of each Ritz value, R = A x - value B x in the norm of B^-1 with x of
unit norm in B, and the Ritz value is above its own by |R|^2 over the distance to the others at most
(B. Parlett, The Symmetric Eigenvalue Problem (1998), sections 4.5, 11.7 and 15.9).  Where B is a
mass the norm is that of its diagonal, which is equivalent whatever the mesh (A. J. Wathen, IMA J.
Numer. Anal. 7 (1987) 449); where it is a stiffness, that of the cycle, which is a few times smaller
than that of its inverse at worst.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.signals import raise_if_agreed
from dolfin_elastic.core.types import BoolArray, FloatArray
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.solvers.linear.hierarchy import Multigrid
from dolfin_elastic.solvers.linear.smoother import random_vector

DROPPED = 1e-11
"""Eigenvalue of a scaled Gram matrix up to which a direction is one of the others."""

ROUGH = 1e-3
"""Residual over the value that is enough where a value is too large to be wanted."""

STEPS = 400
"""Steps after which it has failed: 60 are many, but at nu = 0.499 quadratic elements take 270."""

EXACT = 1e-12
"""Error of a solution by conjugate gradients, over that of zero, in the norm of energy."""

CHUNK = 4096
"""Entries of all vectors that are combined at once."""


class NotConvergedError(Exception):
    """Residuals are too large after all steps, or no numbers."""


class Cycle:
    """A cycle of multigrid of a symmetric matrix, kept as it is. Collective; `destroy` it.

    Args:
        problem: Whose displacement is the only unknown.
        matrix: Positive, or nearly so; it is not freed before the cycle is.
    """

    def __init__(self, problem: Problem, matrix: PETSc.Mat) -> None:
        rows = self._rows = problem.constraints
        self._fixed = np.append(rows.prescribed_dofs, rows.tied_dofs)
        self.pc = PETSc.PC().create(problem.body.comm)
        self.pc.setOperators(matrix)
        self._multigrid = Multigrid(problem, self.pc)

    def improve(self, vectors: FloatArray) -> None:
        """Overwrites residuals, one below the other, by about the inverse times them. Collective.

        By a symmetric positive matrix.
        """
        self._multigrid.apply_to_several(self.pc, vectors)
        self.free(vectors)

    def free(self, vectors: FloatArray) -> None:
        """Takes the constrained part from vectors, one below the other. Local."""
        for vector in vectors if self._rows.skewed else ():
            vector[:] = self._rows.free_part(vector)
        vectors[:, self._fixed] = 0.0

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """Whether conjugate gradients find x, to round-off nearly. Collective."""
        ksp = PETSc.KSP().create(self.pc.comm)
        ksp.setType("cg")
        ksp.setPC(self.pc)
        ksp.setOperators(*self.pc.getOperators())
        ksp.setNormType(PETSc.KSP.NormType.NATURAL)
        ksp.setTolerances(rtol=EXACT, atol=1e-300, max_it=STEPS)
        ksp.solve(b, x)
        converged = ksp.getConvergedReason() > 0
        ksp.destroy()
        return bool(converged)

    def is_positive(self, matrix: PETSc.Mat) -> bool:
        """Whether the lowest eigenvalue of a matrix, over its diagonal, is positive. Collective.

        Raises:
            NotConvergedError: It is too small to be told.
        """
        entries = matrix.getDiagonal()
        entries.array_w[:] = np.abs(entries.array_r)
        self.free(entries.array_w[None])
        diagonal = PETSc.Mat().createDiagonal(entries)
        lowest = Lobpcg(Preconditioned(matrix, diagonal, self), 4, known=())
        lowest.solve(1, 1.0)
        for thing in (diagonal, entries):
            thing.destroy()
        return bool(lowest.values[0] > 0.0)

    def destroy(self) -> None:
        """Frees the multigrid. Collective."""
        for thing in (self._multigrid, self.pc):
            thing.destroy()


class Preconditioned:
    """A x = value B x with a cycle of multigrid as its preconditioner.

    Args:
        B: Not negative, and zero where displacements are constrained; or the cycle's own matrix.
        cycle: Of A, or of B where A is not positive.
        sign: -1 stands for -A in place of A.
        of_B: The cycle is of B, by which residuals are measured then.
    """

    def __init__(
        self,
        A: PETSc.Mat,
        B: PETSc.Mat,
        cycle: Cycle,
        *,
        sign: float = 1.0,
        of_B: bool = False,
    ) -> None:
        self.A, self.B, self.sign = A, B, sign
        self.cycle, self.of_B, self.comm = cycle, of_B, A.comm.tompi4py()
        diagonal = B.getDiagonal()
        entries = diagonal.array_r
        self.weights = np.divide(1.0, entries, out=np.zeros(len(entries)), where=entries > 0.0)
        diagonal.destroy()

    def start(self, number: int) -> FloatArray:
        """One of many initial vectors, which are independent."""
        first, size = self.A.getOwnershipRange()[0], self.A.getSize()[0]
        vector = random_vector(number * size + first, len(self.weights))
        self.cycle.free(vector[None])
        return vector

    def times(self, vectors: FloatArray, of_A: FloatArray, of_B: FloatArray) -> None:
        """A, with its sign, and B times vectors, one below the other. Collective."""
        multiply(self.A, vectors, of_A)
        if self.sign < 0.0:
            np.negative(of_A, out=of_A)
        multiply(self.B, vectors, of_B)


class Lobpcg:
    """Vectors, the first of which become those of the lowest eigenvalues. Collective.

    Args:
        size: How many vectors; those beyond the wanted ones speed up the convergence of these.
        known: Vectors to which all others are to be orthogonal in B; owned entries of each.
        seed: Number of a search, each of which begins with vectors of its own.

    Attributes:
        values: Ritz values, ascending.
        residuals: |R| of each.
        converged: Which of them have.
        steps: So many were taken.
    """

    def __init__(
        self, pencil: Preconditioned, size: int, *, known: Sequence[FloatArray], seed: int = 0
    ) -> None:
        self._of, self._comm, n = pencil, pencil.comm, len(pencil.weights)
        self._known = np.array(known).reshape(len(known), n)
        self._images = np.empty_like(self._known)
        multiply(pencil.B, self._known, self._images)
        self._inverse = np.linalg.pinv(self._products(self._images, self._known))
        self._S = np.empty((3 * size, n))  # X, P and W, one below the other
        self._Y = np.empty((2 * size, n))  # A X and B X, or those of W
        self._PAP, self.steps = np.empty((0, 0)), 0
        self.values: FloatArray = np.zeros(size)
        self.residuals: FloatArray = np.full(size, np.inf)
        self.converged: BoolArray = np.ones(size, dtype=bool)
        for k in range(size):
            self._S[k] = pencil.start(1000 * seed + k)
        self._remove_known(self._S[:size])
        self._combine(*self._products_of_vectors())

    def vectors(self) -> FloatArray:
        """Owned entries of the vectors, one below the other; valid until the next step."""
        return self._S[: len(self.values)]

    def solve(self, count: int, tolerance: float, below: float = np.inf) -> None:
        """Iterates until the lowest values have converged. Collective.

        Args:
            tolerance: Relative error.
            below: Values above are not wanted, and need not converge.

        Raises:
            NotConvergedError: They do not converge.
            StoppedError: A signal has asked for the end of the run.
        """
        least = float(np.sqrt(tolerance)) / (10 if self._of.of_B else 3)
        for self.steps in range(STEPS):
            raise_if_agreed(self._comm)
            GA, GB = self._products_of_vectors()
            self._take_residuals(GA)
            far = np.abs(self.values)
            self.converged = self.residuals <= least * far
            beyond = self.values - self.residuals > below
            beyond[:1] &= self.residuals[:1] <= ROUGH * far[:1]
            if len(far) >= count and (self.converged | beyond)[:count].all():
                return
            self._combine(*self._with_residuals(GA, GB))
        raise NotConvergedError

    def _products(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Products of all of some vectors with all of others. Collective."""
        return np.asarray(total(self._comm, a @ b.T))

    def _remove_known(self, vectors: FloatArray) -> None:
        """Makes vectors orthogonal to the known ones. Collective."""
        _subtract(vectors, self._products(vectors, self._images) @ self._inverse, self._known)

    def _products_in_both(self, vectors: FloatArray, others: FloatArray) -> FloatArray:
        """Those of all of some vectors with all of others in A and in B. Collective.

        Both kinds of images are one array: products of larger matrices take less time.
        """
        count = len(vectors)
        images = self._Y[: 2 * count]
        self._of.times(vectors, images[:count], images[count:])
        return self._products(images, others).reshape(2, count, len(others))

    def _products_of_vectors(self) -> tuple[FloatArray, FloatArray]:
        """Those of X and P in A and B; the images of X stay. Collective."""
        m, p = len(self.values), len(self._PAP)
        S = self._S[: m + p]
        rows, lasts = self._products_in_both(S[:m], S), (self._PAP, np.eye(p))
        GA, GB = (np.block([[r], [r[:, m:].T, k]]) for r, k in zip(rows, lasts, strict=True))
        return GA, GB

    def _take_residuals(self, GA: FloatArray) -> None:
        """Overwrites A X by the residuals among vectors that are not known. Collective."""
        m = len(self.values)
        R, self.values = self._Y[:m], np.diag(GA)[:m].copy()
        for k in range(m):
            R[k] -= self.values[k] * self._Y[m + k]
        _subtract(R, self._products(R, self._known) @ self._inverse, self._images)
        if self._of.of_B:
            W = self._S[m + len(self._PAP) :][:m]
            W[:] = R
            self._of.cycle.improve(W)
            squares = np.array([np.dot(r, w) for r, w in zip(R, W, strict=True)])
        else:
            squares = np.array([np.dot(r * r, self._of.weights) for r in R])
        self.residuals = np.sqrt(total(self._comm, squares))

    def _with_residuals(self, GA: FloatArray, GB: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Makes W of the residuals, and adds its products. Collective."""
        m, s, active = len(self.values), len(GA), np.flatnonzero(~self.converged)
        S = self._S[: s + len(active)]
        W, R = S[s:], self._S[s:] if self._of.of_B else self._Y
        for k, row in enumerate(active):
            W[k] = R[row]
        if not self._of.of_B:
            self._of.cycle.improve(W)
        self._remove_known(W)
        _subtract(W, self._products(W, self._Y[m : 2 * m]), S[:m])
        rows = self._products_in_both(W, S)
        GA, GB = (np.block([[G, r[:, :s].T], [r]]) for G, r in zip((GA, GB), rows, strict=True))
        return GA, GB

    def _combine(self, GA: FloatArray, GB: FloatArray) -> None:
        """Takes the best vectors of the span, and their last changes. Collective."""
        best = None
        # On one rank, so that all go on with the same numbers, whatever their round-off.
        if self._comm.rank == 0:
            with suppress(np.linalg.LinAlgError):
                best = _best(GA, GB, len(self.values), ~self.converged)
        best = self._comm.bcast(best)
        if best is None:
            raise NotConvergedError
        self.values, mix, self._PAP = best
        self.converged = self.converged[: len(self.values)]
        for k in range(0, self._S.shape[1], CHUNK):
            part = self._S[: len(GA), k : k + CHUNK]
            self._S[: len(mix), k : k + CHUNK] = mix @ part


def _best(
    GA: FloatArray, GB: FloatArray, count: int, active: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Lowest Ritz values in a span, and combinations of it, each a row; None: no numbers.

    Args:
        GA: Products in A of the vectors that span it.
        GB: Their products in B, which need not be regular.
        count: How many values; as many vectors come first.
        active: Of which of these the last changes are wanted.

    Returns:
        The values, the vectors and the changes of active ones, orthonormal in B, and products of
        the changes in A.
    """
    if not (np.isfinite(GA).all() and np.isfinite(GB).all()):
        return None
    C = _orthonormal(GB)
    values, mixes = np.linalg.eigh(_symmetric(C.T @ GA @ C))
    V = (C @ mixes)[:, :count]
    changes = V[:, active[: V.shape[1]]].copy()
    changes[:count] = 0.0
    changes -= V @ (V.T @ GB @ changes)
    changes = changes @ _orthonormal(changes.T @ GB @ changes)
    return values[:count], np.hstack([V, changes]).T, _symmetric(changes.T @ GA @ changes)


def _orthonormal(G: FloatArray) -> FloatArray:
    """Combinations of vectors with these products that are orthonormal, without tiny ones."""
    diagonal = np.diag(G)
    scale = np.zeros(len(G))
    np.divide(1.0, np.sqrt(np.abs(diagonal)), out=scale, where=diagonal > 0.0)
    sizes, mixes = np.linalg.eigh(_symmetric(scale[:, None] * G * scale))
    kept = sizes > DROPPED
    return np.asarray(scale[:, None] * mixes[:, kept] / np.sqrt(sizes[kept]))


def _symmetric(G: FloatArray) -> FloatArray:
    return np.asarray((G + G.T) / 2)


def _subtract(vectors: FloatArray, factors: FloatArray, others: FloatArray) -> None:
    """Subtracts combinations of other vectors, one for each."""
    for k in range(0, vectors.shape[1], CHUNK) if len(others) else ():
        vectors[:, k : k + CHUNK] -= factors @ others[:, k : k + CHUNK]


def multiply(matrix: PETSc.Mat, vectors: FloatArray, images: FloatArray) -> None:
    """A matrix times several vectors at once, which takes a quarter of the time. Collective.

    Args:
        vectors: Owned entries, one vector below the other.
        images: Is overwritten by as many vectors, in the same order.
    """
    if not len(vectors):
        return
    if matrix.getType() == "python":
        matrix.getPythonContext().times_several(vectors, images)
        return
    size = matrix.getSizes()[0]
    X, Y = (
        PETSc.Mat().createDense((size, (None, len(a))), array=a.T, comm=matrix.comm)
        for a in (vectors, images)
    )
    for dense in (X, Y):
        dense.assemble()
    matrix.matMult(X, result=Y)
    X.destroy()
    Y.destroy()
