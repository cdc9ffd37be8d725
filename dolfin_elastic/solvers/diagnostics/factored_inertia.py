"""The inertia of a tangent that is not symmetric, by its factors.

With the tangent A factorised, a force f costs one solve, y = A^-1 f, and y . A y = y . f is the
curvature of the symmetric part M along y without any product.  So Rayleigh's quotients of M on the
Krylov space of A^-1, in which soft modes stand out, show directions X of negative curvature for two
solves; the sign of the determinant shows an odd number of negative eigenvalues.

What neither shows is an even number of stiff ones.  The factors L D L^T of M count them all: where
M is positive definite, A is stable.  Where M has as many negative eigenvalues as X has columns, it
is positive definite on the complement of D = M X, and the inertia of A there is that of the
identity; D^T A^-1 D has the rest, see `negative_curvature`.

All of this is of displacements, other fields eliminated: forces act on displacements alone.

Source: E. V. Haynsworth, Linear Algebra Appl. 1 (1968) 73.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from petsc4py import PETSc

from dolfin_elastic.core.parallel import total
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.diagnostics.negative_curvature import (
    FLUTTER,
    ROUND_OFF,
    Inertia,
    by_directions,
    noise,
    start_vector,
)
from dolfin_elastic.solvers.nonlinear.newton import Newton

DETERMINANT = 12
"""Index of its mantissa in MUMPS's RINFOG."""

GLANCE, SEARCH = 2, 24
"""Solves for a first look, and for all directions of negative curvature: two at a time, as two
modes of a square column are equal."""

SOFTEST, COMPLEX = 0.1, 0.02
"""Compliances over the largest one that are looked at for flutter, and imaginary over absolute
values from which they count as complex: two that are equal differ by round-off."""


def count_by_factors(newton: Newton, symmetric_part: int | None = None) -> Inertia:
    """Negative eigenvalues of the fields' last tangent, those of pressures left out. Collective.

    Args:
        newton: The solver, which has factorised an unsymmetric tangent.
        symmetric_part: Negative eigenvalues of the symmetric part; None: not known, then only
            soft ones and an odd number are seen.
    """
    with newton.linear.left_as_it_is():
        odd = _is_odd(newton.linear.factors, newton.assembler)
        if symmetric_part == 0:
            return Inertia(0)
        space = _Krylov(newton)
        inertia = _inertia(space, symmetric_part)
        space.destroy()
    if odd is None or inertia.negative is None or inertia.negative % 2 == odd:
        return inertia
    return replace(inertia, negative=inertia.negative + 1, at_least=True)


def _inertia(space: _Krylov, symmetric_part: int | None) -> Inertia:
    if symmetric_part is None:
        space.grow(1)
        space.grow(1)
        X = space.negative()
        return space.verdict(X, at_least=True) if len(X) else Inertia(0)
    while True:
        space.grow(2)
        X = space.negative()
        if len(X) >= symmetric_part:
            inertia = space.verdict(X, at_least=False)
            return inertia if inertia.negative else space.flutter() or inertia
        if space.count >= SEARCH:
            inertia = space.verdict(X, at_least=True) if len(X) else Inertia(0)
            return Inertia(
                None,
                direction=inertia.direction,
                reason=f"its tangent is not symmetric, and of {symmetric_part} directions of "
                f"negative stiffness {len(X)} are known",
            )


class _Krylov:
    """Forces F, orthonormal, and the displacements and pressures A^-1 F. Collective."""

    def __init__(self, newton: Newton) -> None:
        self._assembler = newton.assembler
        self._A, self._pc = newton.assembler.tangent.matrix, newton.ksp.getPC()
        self._x, self._y = (newton.assembler.create_vector() for _ in range(2))
        self._moves, self._comm = newton.assembler.displacement_dofs, newton.assembler.comm
        self._F: list[FloatArray] = []
        self._Y: list[FloatArray] = []
        starts = newton.soft.starts or (noise(newton.assembler), start_vector(newton.assembler))
        newton.soft = replace(newton.soft, starts=starts)
        self._next = list(starts)

    @property
    def count(self) -> int:
        """How many forces there are."""
        return len(self._F)

    def grow(self, number: int) -> None:
        """Adds forces: the first displacements that are none yet. Collective."""
        for _ in range(number):
            f = self._orthonormal(self._F, self._free(self._next.pop(0)))
            y = self._inverse(f)
            self._F.append(f)
            self._Y.append(y)
            moved = y[self._moves]
            self._next.insert(number - 1, np.asarray(moved / max(self._size(moved), 1e-300)))
            # A block of two goes on with both displacements, a single force with its own.

    def negative(self) -> FloatArray:
        """Coefficients of forces along whose displacements the curvature is negative, one a row.

        Collective.
        """
        G = self._compliances()
        sizes = np.sqrt(np.abs(np.diag(G)))
        scale = np.divide(1.0, sizes, out=np.zeros_like(sizes), where=sizes > 0.0)
        values, vectors = np.linalg.eigh(scale[:, None] * (G + G.T) / 2 * scale)
        return np.asarray((vectors[:, values < -ROUND_OFF] * scale[:, None]).T)

    def _compliances(self) -> FloatArray:
        """F^T A^-1 F. Collective."""
        return np.asarray(
            total(self._comm, np.array(self._F) @ np.array(self._Y)[:, self._moves].T)
        )

    def verdict(self, X: FloatArray, *, at_least: bool) -> Inertia:
        """What D = M X says. Collective.

        Args:
            X: Coefficients, as `negative` gives them.
            at_least: M need not be positive definite on the complement of D.
        """
        D: list[FloatArray] = []
        for row in X:
            self._x.array_w[:] = row @ np.array(self._Y)
            self._A.multTranspose(self._x, self._y)
            image = (row @ np.array(self._F) + self._y.array_r[self._moves]) / 2
            D.append(self._orthonormal(D, self._free(image)))
        Y = [self._inverse(d)[self._moves] for d in D]
        inertia = by_directions(self._comm, np.array(D), np.array(Y), at_least=at_least)
        if inertia.direction is None:
            return inertia
        w = np.zeros(self._assembler.size)
        w[self._moves] = inertia.direction
        self._assembler.extend(w)
        return replace(inertia, direction=w)

    def flutter(self) -> Inertia | None:
        """No verdict, where softest eigenvalues of A are complex; None where they are real.

        By Arnoldi's method.  The symmetric part is indefinite: A has no negative eigenvalue only
        because it is not symmetric, as that of a column under a force that turns with its end.
        Collective.
        """
        self.grow(SEARCH - self.count)
        compliances = np.linalg.eigvals(self._compliances())
        sizes = np.abs(compliances)
        soft = sizes > SOFTEST * sizes.max()
        if np.any(np.abs(compliances[soft].imag) > COMPLEX * sizes[soft]):
            return Inertia(None, reason=FLUTTER)
        return None

    def _inverse(self, f: FloatArray) -> FloatArray:
        """A^-1 f, owned entries of all unknowns. Collective."""
        self._x.set(0.0)
        self._x.array_w[self._moves] = f
        self._pc.apply(self._x, self._y)
        self._assembler.remove_constrained(self._y)
        return np.asarray(self._y.array_r.copy())

    def _free(self, f: FloatArray) -> FloatArray:
        """Without constrained components."""
        self._x.set(0.0)
        self._x.array_w[self._moves] = f
        self._assembler.remove_constrained(self._x)
        return np.asarray(self._x.array_r[self._moves].copy())

    def _orthonormal(self, others: list[FloatArray], f: FloatArray) -> FloatArray:
        """What is left of a force beside others, of size 1; zero where nothing is. Collective."""
        before = self._size(f)
        for _ in range(2 if others else 0):  # twice is enough for round-off
            Q = np.array(others)
            f = f - Q.T @ total(self._comm, Q @ f)
        size = self._size(f)
        return np.asarray(f / size if size > ROUND_OFF * before else np.zeros_like(f))

    def _size(self, f: FloatArray) -> float:
        return float(np.sqrt(total(self._comm, float(f @ f))))

    def destroy(self) -> None:
        """Frees its vectors. Collective."""
        self._x.destroy()
        self._y.destroy()


def _is_odd(pc: PETSc.PC, assembler: Assembler) -> bool | None:
    """Whether the number of negative eigenvalues is odd, by the sign of the determinant.

    Complex eigenvalues come in pairs, whose product is positive.  Those of pressures are left out.
    None where the factors have no determinant.
    """
    if pc.getType() != "lu" or pc.getFactorSolverType() != "mumps":
        return None
    factors = pc.getFactorMatrix()
    mantissa = factors.getMumpsRinfog(DETERMINANT)
    if factors.getMumpsIcntl(33) != 1 or mantissa == 0.0:
        return None
    return bool((mantissa < 0.0) != (assembler.pressures % 2 == 1))
