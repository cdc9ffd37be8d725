"""Functions of a small number whose value is small, too: without the rounding of 1 + x.

ln(1 + x) and e^x - 1 lose all digits where x is below 1e-16; energies and stresses of a body that
is hardly strained are made of them.

Source: N. J. Higham, Accuracy and Stability of Numerical Algorithms (2002), sections 1.14 and 1.17.
"""

from __future__ import annotations

from collections.abc import Sequence

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.types import Scalar

NEAR = 5e-3
"""Below it series stand for logarithm and exponential."""
TERMS = 8
"""Of these series: the next term is below 1e-19 of the first."""

_LOGARITHM = [(-1) ** (n + 1) / n for n in range(1, TERMS + 1)]


def polynomial(coefficients: Sequence[Scalar], x: Expr) -> Expr:
    """Sum of c_n x^(n+1), n = 0, 1, ..., by Horner's rule."""
    total: Scalar = 0.0
    for coefficient in reversed(coefficients):
        total = (total + coefficient) * x
    return total


def log1p(x: Expr, whole: Expr | None = None) -> Expr:
    """ln(1 + x); NaN where x < -1.

    Args:
        whole: 1 + x, if it is known without rounding where it is small itself.
    """
    far = ufl.ln(1 + x if whole is None else whole)
    return ufl.conditional(ufl.lt(abs(x), NEAR), polynomial(_LOGARITHM, x), far)


def log1p_less(x: Expr, whole: Expr | None = None) -> Expr:
    """ln(1 + x) - x, of second order in x; NaN where x < -1.

    Args:
        x: See `log1p`.
        whole: See `log1p`.
    """
    series = x * polynomial(_LOGARITHM[1:], x)
    far = ufl.ln(1 + x if whole is None else whole) - x
    return ufl.conditional(ufl.lt(abs(x), NEAR), series, far)


def expm1(x: Expr) -> Expr:
    """e^x - 1 = 2 sinh(x/2) e^(x/2), smooth and without a condition."""
    return 2 * ufl.sinh(x / 2) * ufl.exp(x / 2)


def expm1_less(x: Expr) -> Expr:
    """e^x - 1 - x = 2 sinh(x/2)^2 + (sinh(x) - x), of second order in x."""
    odd = x**3 * (1 / 6 + polynomial([1 / 120, 1 / 5040, 1 / 362880], x**2))
    return 2 * ufl.sinh(x / 2) ** 2 + ufl.conditional(ufl.lt(abs(x), 0.1), odd, ufl.sinh(x) - x)
