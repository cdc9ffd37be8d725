"""Principal stretches that can be differentiated where they coincide."""

from __future__ import annotations

import math

import ufl
from ufl.core.expr import Expr

_SHAPE, _ROOT = 1e-13, 1e-12
"""What is added to the deviator's square and to 1 - r^2, so that neither root starts at 0."""


def principal_stretches(F: Expr) -> tuple[Expr, Expr, Expr]:
    """The stretches, from the largest to the smallest: square roots of the eigenvalues of F^T F.

    Eigenvalues by the trigonometric solution of the cubic, with small positive numbers added
    under both roots: at equal stretches the first and second derivatives of a symmetric function
    of them stay right to about 1e-10, where a clamped angle would be wrong by per cents.

    Source: G. Scherzinger and C. Dohrmann, Comput. Methods Appl. Mech. Engrg. 197 (2008) 4007,
    section 2, for the roots in terms of the deviator's invariants.

    Args:
        F: Deformation gradient, shape (3, 3).
    """
    C = F.T * F
    q = ufl.tr(C) / 3
    dev = C - q * ufl.Identity(3)
    p = 2 * ufl.sqrt((ufl.inner(dev, dev) / 2 + _SHAPE * q**2) / 3)
    r = 4 * ufl.det(dev) / p**3
    angle = ufl.atan2(ufl.sqrt(1 - r**2 + _ROOT), r) / 3
    first, last, middle = (ufl.sqrt(q + p * ufl.cos(angle + 2 * math.pi / 3 * k)) for k in range(3))
    return first, middle, last
