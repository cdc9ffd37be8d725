"""Energies of principal stretches, without eigenvectors: exact and smooth where stretches meet.

An energy of the stretches is written in invariants that are smooth in F, and its stress by the
chain rule on them: differentiating the formulas for the eigenvalues through F takes a compiler
minutes, and eigenvectors do not exist where stretches meet, as they do at F = I.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.types import Scalar
from dolfin_elastic.model.kinematics import green_strain, less_cofactor, polynomial, volume_change

CLOSE = 1e-4
"""Value of j2 below which series stand for the eigenvalues: stretches within about one per cent."""
ORDER = 8
"""Powers of the deviator in the series: its next term is below round-off."""
ORDER_OF_D = 4
"""The same of d - 1, which is at most about `CLOSE`."""
SPLIT = 1e-12
"""Keeps the angle differentiable where two stretches meet; costs the energy 1e-13 of itself."""
CRUSHED = 1e-6
"""Smallest squared stretch, over their mean, that the cosine gives well."""


@dataclass(frozen=True)
class Shape(ABC):
    """Functions of F in which an isochoric energy of the stretches is written.

    Attributes:
        d: det C / q^3, q = tr C / 3; NaN where J < 0.
    """

    d: Expr

    @abstractmethod
    def excess(self, f: Callable[[Expr], Expr], series: Sequence[Scalar]) -> Expr:
        """Sum of f - f(1) over the three squared stretches, a UFL scalar.

        Args:
            f: Function of one squared stretch over q.
            series: Its Taylor coefficients at 1, of the powers 0 to `ORDER`.
        """

    @abstractmethod
    def of_d(self, f: Callable[[Expr], Expr], series: Sequence[Scalar]) -> Expr:
        """f(d) - f(1), a UFL scalar.

        Args:
            series: As for `excess`.
        """


@dataclass(frozen=True)
class _Apart(Shape):
    """Where stretches are well apart.

    Attributes:
        squares: Squared stretches over q.
    """

    squares: tuple[Expr, Expr, Expr]

    def excess(self, f: Callable[[Expr], Expr], series: Sequence[Scalar]) -> Expr:
        """See `Shape`."""
        return sum(f(square) for square in self.squares) - 3 * series[0]

    def of_d(self, f: Callable[[Expr], Expr], series: Sequence[Scalar]) -> Expr:
        """See `Shape`."""
        return f(self.d) - series[0]


@dataclass(frozen=True)
class _Close(Shape):
    """Where all stretches are close.

    Attributes:
        powers: Traces of the powers 0, 1, ... `ORDER` of C/q - I.
        change: d - 1.
    """

    powers: tuple[Scalar, ...]
    change: Expr

    def excess(self, f: Callable[[Expr], Expr], series: Sequence[Scalar]) -> Expr:
        """See `Shape`."""
        return sum(c * s for c, s in zip(series[2:], self.powers[2:], strict=True))

    def of_d(self, f: Callable[[Expr], Expr], series: Sequence[Scalar]) -> Expr:
        """See `Shape`."""
        return polynomial(series[1 : ORDER_OF_D + 1], self.change)


def _cosine(j2: Expr, j3: Expr) -> Expr:
    """cos(3 theta) = 4 j3/p^3; where stretches are close, a differentiable substitute."""
    return 4 * j3 / (2 * ufl.sqrt(ufl.max_value(j2, CLOSE) / 3)) ** 3


def _close(j2: Expr, j3: Expr, d: Expr, change: Expr) -> _Close:
    """From the invariants of b = C/q - I: b^3 = j2 b + j3, Cayley and Hamilton.

    Args:
        j2: b:b/2.
        d: Product of the squares, 1 - j2 + j3.
        change: d - 1.
    """
    powers: list[Scalar] = [3.0, 0.0, 2 * j2]
    while len(powers) <= ORDER:
        powers.append(j2 * powers[-2] + j3 * powers[-3])
    return _Close(d, tuple(powers), change)


def _apart(j2: Expr, d: Expr, r: Expr) -> _Apart:
    """From the invariants of b = C/q - I.

    The eigenvalues of b are p cos(theta + 2 k pi/3) with p = 2 sqrt(j2/3).  Regularised, theta is
    even in the gap between stretches that meet, and so must be what is made of it: then errors are
    of the order of theta squared.  Only where the smallest square would cancel does it follow from
    the product of all.

    Args:
        j2: b:b/2.
        r: See `_cosine`.

    Source: O. K. Smith, Commun. ACM 4 (1961) 168 (the eigenvalues).
    """
    p = 2 * ufl.sqrt(ufl.max_value(j2, CLOSE) / 3)
    theta = ufl.atan2(ufl.sqrt(1 - r * r + SPLIT), r) / 3
    first = 1 + p * ufl.cos(theta)
    second = 1 + p * ufl.cos(theta - 2 * math.pi / 3)
    third = 1 + p * ufl.cos(theta + 2 * math.pi / 3)
    third = ufl.conditional(ufl.lt(third, CRUSHED), d / (first * second), third)
    return _Apart(d, (first, second, third))


def _invariants(F: Expr) -> tuple[Expr, Expr, Expr, Expr, Expr]:
    """b = C/q - I = 2 dev E/q, q = tr C / 3, and j2, j3, d."""
    q = ufl.inner(F, F) / 3
    b = 2 / q * ufl.dev(green_strain(F))
    d = ufl.exp(2 * ufl.ln(ufl.det(F))) / q**3  # the logarithm refuses J < 0, which J^2 would not
    return b, q, ufl.inner(b, b) / 2, ufl.det(b), d


@dataclass(frozen=True)
class Polar:
    """The polar decomposition F = R U.

    With J < 0 the smallest stretch counts as negative, so R stays a rotation and all stay smooth
    up to where the two smallest stretches add to zero.

    Attributes:
        R: Rotation.
        stretching: F - R = R (U - I), without the rounding of F and R.
        trace: tr U - 3, without the rounding of tr U.
    """

    R: Expr
    stretching: Expr
    trace: Expr


def polar(F: Expr) -> Polar:
    """The polar decomposition of a deformation gradient, shape (3, 3).

    x = tr U is a root of x^4 - 2 I1 x^2 - 8 J x + I1^2 - 4 I2 = 0, I1 and I2 invariants of C, and
    R = dx/dF follows from that: R = ((x^2 + I1) F - 2 F C + 2 x cof F)/(2 h) with
    h = x (x^2 - I1)/2 - J, the product of the sums of two stretches.  F - R is written in strains:
    2 h (F - R) = k F + 2 x (F - cof F) + 2 F (C - I) with k = 2 h - x^2 - I1 + 2 - 2 x, in which
    x = 3 + t, I1 = 3 + 2 tr E and J = 1 + j leave no constant.

    Source: L. P. Franca, Comput. Math. Appl. 18 (1989) 459 (the quartic); differentiated here.
    """
    _, q, j2, j3, _ = _invariants(F)
    J, root = ufl.det(F), ufl.sqrt(q)
    d = 1 - j2 + j3
    near = _close(j2, j3, d, j3 - j2).excess(ufl.sqrt, power_series(0.5))
    first, second = (ufl.sqrt(square) for square in _apart(j2, d, _cosine(j2, j3)).squares[:2])
    # The smallest stretch follows from the product of all, with the sign of J.
    apart = first + second + J / (root**3 * first * second) - 3
    E, j, I1 = green_strain(F), volume_change(F), 3 * q
    s = ufl.tr(E)
    # tr U - 3, of which sqrt(q) - 1 is (q - 1)/(1 + sqrt(q)).
    t = 2 * s / (1 + root) + root * ufl.conditional(ufl.lt(j2, CLOSE), near, apart)
    x = 3 + t
    k = t * (16 + t * (8 + t) - 2 * s) - 8 * s - 2 * j
    h2 = (x * x - I1) * x - 2 * J
    stretching = (k * F + 2 * x * less_cofactor(F) + 4 * (F * E)) / h2
    return Polar(F - stretching, stretching, t)


def isochoric_energy(psi: Callable[[Shape], Expr], F: Expr) -> Expr:
    """An energy of the isochoric stretches [J/m^3].

    Args:
        psi: The energy as a function of a `Shape`.
        F: Deformation gradient, shape (3, 3).
    """
    _, _, j2, j3, d = _invariants(F)
    apart = psi(_apart(j2, d, _cosine(j2, j3)))
    # d - 1 is of second order; the logarithm refuses J < 0.
    change = ufl.conditional(ufl.gt(ufl.det(F), 0), j3 - j2, ufl.ln(ufl.det(F)))
    return ufl.conditional(ufl.lt(j2, CLOSE), psi(_close(j2, j3, d, change)), apart)


def isochoric_stress(psi: Callable[[Shape], Expr], F: Expr) -> Expr:
    """First Piola-Kirchhoff stress of psi, by the chain rule on j2 and j3.

    dj2/dF = 2/q (F b - 2/3 j2 F) and dj3/dF = 2/q (F b^2 - (2/3 j2 + j3) F), from b = C/q - I.

    Args:
        psi: Energy [J/m^3] as a function of a `Shape`.
        F: Deformation gradient, shape (3, 3).
    """
    b, q, *values = _invariants(F)
    j2, j3, d, r = (ufl.variable(value) for value in (*values, _cosine(values[0], values[1])))
    near, apart = psi(_close(j2, j3, d, d - 1)), psi(_apart(j2, d, r))
    near_d, apart_d = ufl.diff(near, d), ufl.diff(apart, d)
    # Where stretches meet the angle's derivatives are large, and cancel only along dr/dF = 0:
    # they are taken once, by r, and then along j2 and j3.
    by_r, safe = ufl.diff(apart, r), ufl.max_value(j2, CLOSE)
    apart_j2 = ufl.diff(apart, j2) - apart_d - by_r * 1.5 * r / safe
    apart_j3 = apart_d + by_r * 4 / (2 * ufl.sqrt(safe / 3)) ** 3
    # Chosen as late as can be: each condition becomes nine in the tangent.
    close = ufl.lt(j2, CLOSE)
    by_j2 = ufl.conditional(close, ufl.diff(near, j2) - near_d, apart_j2)
    by_j3 = ufl.conditional(close, ufl.diff(near, j3) + near_d, apart_j3)
    Fb = F * b
    along_F = 2 / 3 * j2 * (by_j2 + by_j3) + j3 * by_j3
    return 2 / q * (by_j2 * Fb + by_j3 * (Fb * b) - along_F * F)


def power_series(exponent: Scalar) -> list[Scalar]:
    """Taylor coefficients of (1 + b)^exponent."""
    terms: list[Scalar] = [1.0]
    for n in range(1, ORDER + 1):
        terms.append(terms[-1] * (exponent - (n - 1)) / n)
    return terms


def log_series() -> list[float]:
    """Taylor coefficients of ln(1 + b)."""
    return [0.0] + [(-1) ** (n + 1) / n for n in range(1, ORDER + 1)]


def square_of_log_series() -> list[float]:
    """Taylor coefficients of ln(1 + b)^2: 2 (-1)^n H(n-1)/n, H the harmonic numbers."""
    harmonic = [sum(1 / k for k in range(1, n)) for n in range(ORDER + 1)]
    return [0.0, 0.0] + [2 * (-1) ** n * harmonic[n] / n for n in range(2, ORDER + 1)]
