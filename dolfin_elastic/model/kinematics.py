"""Kinematics and stress measures as pure UFL functions.

Every function takes and returns UFL expressions (or anything UFL can make one of), needs no
mesh, and works in 2D and 3D: tensors are of shape (d, d).  X is a point of the reference
configuration, x = X + u its place in the current one.

Strains are differences from F = I, and F = I + grad u has rounded off all digits of grad u below
1e-16.  So strains are computed from the displacement gradient H = grad u, which
`displacement_gradient` finds in an F that is written as the sum I + H.  ln(1 + x) and e^x - 1, too,
lose all digits where x is below 1e-16; energies and stresses of a body that is hardly strained are
made of functions that do not (N. J. Higham, Accuracy and Stability of Numerical Algorithms (2002),
sections 1.14 and 1.17).

Source: Bonet & Wood, Nonlinear Continuum Mechanics for Finite Element Analysis, 2nd ed.,
Cambridge 2008, chapters 4 (kinematics) and 5 (stress); equation numbers below are theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import ufl
from ufl.classes import Identity, Sum
from ufl.core.expr import Expr

from dolfin_elastic.core.types import FloatArray, Scalar

Geometry = Literal["plane-strain", "plane-stress", "axisymmetric"]
GEOMETRIES: tuple[str, ...] = get_args(Geometry)


@dataclass(frozen=True)
class WeightedMeasure:
    """A measure of a plane mesh times thickness or circumference.

    Attributes:
        weight: Factor of every integrand; None: 1.
        measure: UFL measure of the mesh.
    """

    weight: Expr | None
    measure: ufl.Measure

    def ufl_domain(self) -> ufl.Mesh:
        """The mesh in UFL."""
        return self.measure.ufl_domain()

    def __call__(self, **kwargs: Any) -> WeightedMeasure:
        """The same with another quadrature rule, see `ufl.Measure`."""
        return WeightedMeasure(self.weight, self.measure(**kwargs))

    def __rmul__(self, integrand: Expr) -> ufl.Form:
        """The integral's form."""
        return (integrand if self.weight is None else integrand * self.weight) * self.measure


def weight(geometry: Geometry, x: Expr, thickness: Expr | None) -> Expr | None:
    """Thickness or circumference by which integrals over a plane mesh are multiplied.

    Args:
        x: Reference coordinates; x[0] is the radius of an axisymmetric body, x[1] its axis.
        thickness: Of a plane body; None: 1.
    """
    return 2 * ufl.pi * x[0] if geometry == "axisymmetric" else thickness


def full_gradient(geometry: Geometry, u: Expr, x: Expr, stretch: Expr | None) -> Expr:
    """The 3x3 deformation gradient of a displacement.

    Args:
        geometry: Kind of body, if it is two-dimensional.
        u: Displacement, 2 or 3 components.
        x: Reference coordinates.
        stretch: Displacement gradient out of the plane, F33 - 1, in plane stress.

    In an axisymmetric body F33 is current over reference circumference, 1 + u_r/r.

    Source: Holzapfel, Nonlinear Solid Mechanics (2000), section 2.4 (gradient in cylindrical
    coordinates).
    """
    return deformation_from(gradient_variation(geometry, u, x, stretch))


def gradient_variation(geometry: Geometry, v: Expr, x: Expr, stretch: Expr | None) -> Expr:
    """Variation of `full_gradient`, linear in v and the virtual stretch.

    Args:
        geometry: Kind of body, if it is two-dimensional.
        v: Virtual displacement, 2 or 3 components.
        x: Reference coordinates.
        stretch: Variation of F33 in plane stress.

    Returns:
        UFL tensor of shape (3, 3).
    """
    if len(v) == 3:
        return ufl.grad(v)
    if geometry == "axisymmetric":
        return padded(ufl.grad(v), v[0] / x[0])
    return padded(ufl.grad(v), 0.0 if stretch is None else stretch)


def moment_of(arms: FloatArray, forces: FloatArray) -> FloatArray:
    """Moments of forces [N m], shape (..., 3), in a plane (..., 1).

    Args:
        arms: From the point of reference to where they act [m], shape (..., dim).
        forces: The forces [N], shape (..., dim).
    """
    if arms.shape[-1] == 2:
        return np.asarray(arms[..., :1] * forces[..., 1:] - arms[..., 1:] * forces[..., :1])
    return np.asarray(np.cross(arms, forces))


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


def deformation_gradient(u: Expr) -> Expr:
    """F = I + grad u, grad with respect to X (4.42)."""
    return deformation_from(ufl.grad(u))


def deformation_from(H: Expr) -> Expr:
    """F = I + H, in which `displacement_gradient` finds the displacement gradient H again."""
    return ufl.Identity(H.ufl_shape[0]) + H


def displacement_gradient(F: Expr) -> Expr:
    """H = F - I: of a sum I + H the term H itself, without the rounding of I + H."""
    if isinstance(F, Sum):
        first, second = F.ufl_operands
        if isinstance(first, Identity):
            return second
        if isinstance(second, Identity):
            return first
    return F - ufl.Identity(F.ufl_shape[0])


def variables(F: Expr) -> tuple[Expr, Expr]:
    """H = F - I as a UFL variable, and F = I + H: derivatives with respect to H are those by F."""
    H = ufl.variable(displacement_gradient(F))
    return H, deformation_from(H)


def jacobian(F: Expr) -> Expr:
    """J = det F, current over reference volume (4.57)."""
    return ufl.det(F)


def volume_change(F: Expr) -> Expr:
    """J - 1 of a 3D F: the sum of the principal invariants of F - I."""
    H = displacement_gradient(F)
    return ufl.tr(H) + (ufl.tr(H) ** 2 - ufl.inner(H.T, H)) / 2 + ufl.det(H)


def right_cauchy_green(F: Expr) -> Expr:
    """C = F^T F (4.15)."""
    return F.T * F


def left_cauchy_green(F: Expr) -> Expr:
    """b = F F^T (4.17)."""
    return F * F.T


def log_volume(F: Expr) -> Expr:
    """ln J of a 3D F; NaN where J < 0."""
    return log1p(volume_change(F), ufl.det(F))


def green_strain(F: Expr) -> Expr:
    """E = (F^T F - I) / 2 (4.18b), from H = F - I: (H + H^T + H^T H) / 2."""
    H = displacement_gradient(F)
    return (H + H.T + H.T * H) / 2


def almansi_strain(F: Expr) -> Expr:
    """e = (I - b^-1) / 2 (4.19b), the push-forward F^-T E F^-1 of E (4.21)."""
    inverse = ufl.inv(F)
    return inverse.T * green_strain(F) * inverse


def infinitesimal_strain(F: Expr) -> Expr:
    """eps = (grad u + grad u^T) / 2, from F = I + grad u (4.96)."""
    return ufl.sym(displacement_gradient(F))


def invariants(C: Expr) -> tuple[Expr, Expr, Expr]:
    """I1 = tr C, I2 = ((tr C)^2 - tr C^2) / 2, I3 = det C of a 3D tensor (6.16)."""
    return ufl.tr(C), (ufl.tr(C) ** 2 - ufl.tr(C * C)) / 2, ufl.det(C)


def isochoric_invariants(C: Expr) -> tuple[Expr, Expr]:
    """I1 J^-2/3 and I2 J^-4/3 of a 3D tensor C (6.51)."""
    first, second, third = invariants(C)
    return first * third ** (-1 / 3), second * third ** (-2 / 3)


def padded(A: Expr, out_of_plane: float = 0.0) -> Expr:
    """A plane tensor as a 3x3 one.

    Args:
        A: Shape (2, 2), or (3, 3), which is returned as it is.
        out_of_plane: A33; the other components out of the plane are 0.
    """
    if A.ufl_shape == (3, 3):
        return A
    return ufl.as_tensor([[A[0, 0], A[0, 1], 0], [A[1, 0], A[1, 1], 0], [0, 0, out_of_plane]])


def embedded(F: Expr) -> Expr:
    """The 3x3 deformation gradient of plane strain; a 3x3 one is returned as it is."""
    return padded(F, 1.0)


def cofactor(F: Expr) -> Expr:
    """cof F = J F^-T, which turns area vectors: n da = cof F N dA (Nanson, 4.68).

    The matrix of the minors: a polynomial, also where J = 0.
    """
    if F.ufl_shape == (2, 2):
        return ufl.as_matrix([[F[1, 1], -F[1, 0]], [-F[0, 1], F[0, 0]]])

    def minor(i: int, j: int) -> Expr:
        """The minor of F11 ... F33 with its sign.

        Args:
            i: The row that is left out, from 0.
            j: The column that is left out, from 0.
        """
        a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
        return F[a, c] * F[b, d] - F[a, d] * F[b, c]

    return ufl.as_matrix([[minor(i, j) for j in range(3)] for i in range(3)])


def less_cofactor(F: Expr) -> Expr:
    """F - cof F of a 3D F, from H = F - I with cof F = (1 + tr H) I - H^T + cof H."""
    H = displacement_gradient(F)
    return H + H.T - ufl.tr(H) * ufl.Identity(3) - cofactor(H)


# Conversions between stress measures, all [Pa] of shape (d, d) as F: P first Piola-Kirchhoff (force
# over reference area), S second Piola-Kirchhoff, tau Kirchhoff, sigma Cauchy (over current area).


def first_from_second(S: Expr, F: Expr) -> Expr:
    """P = F S (5.45a)."""
    return F * S


def second_from_first(P: Expr, F: Expr) -> Expr:
    """S = F^-1 P (5.45a)."""
    return ufl.inv(F) * P


def kirchhoff_from_first(P: Expr, F: Expr) -> Expr:
    """tau = P F^T (5.34)."""
    return P * F.T


def first_from_kirchhoff(tau: Expr, F: Expr) -> Expr:
    """P = tau F^-T (5.34)."""
    return tau * ufl.inv(F).T


def cauchy_from_first(P: Expr, F: Expr) -> Expr:
    """sigma = P F^T / J (5.45a)."""
    return P * F.T / ufl.det(F)


def first_from_cauchy(sigma: Expr, F: Expr) -> Expr:
    """P = J sigma F^-T (5.32)."""
    return ufl.det(F) * sigma * ufl.inv(F).T


def kirchhoff_from_cauchy(sigma: Expr, F: Expr) -> Expr:
    """tau = J sigma (5.30)."""
    return ufl.det(F) * sigma


def cauchy_from_kirchhoff(tau: Expr, F: Expr) -> Expr:
    """sigma = tau / J (5.30)."""
    return tau / ufl.det(F)


def kirchhoff_from_second(S: Expr, F: Expr) -> Expr:
    """tau = F S F^T, the push-forward (5.47b)."""
    return F * S * F.T


def second_from_kirchhoff(tau: Expr, F: Expr) -> Expr:
    """S = F^-1 tau F^-T, the pull-back (5.47a)."""
    return ufl.inv(F) * tau * ufl.inv(F).T


def cauchy_from_second(S: Expr, F: Expr) -> Expr:
    """sigma = F S F^T / J (5.45b)."""
    return F * S * F.T / ufl.det(F)


def second_from_cauchy(sigma: Expr, F: Expr) -> Expr:
    """S = J F^-1 sigma F^-T (5.43)."""
    return ufl.det(F) * ufl.inv(F) * sigma * ufl.inv(F).T


def von_mises(sigma: Expr) -> Expr:
    """sqrt(3/2 s:s), s the deviator of a 3x3 Cauchy stress (von Mises, 1913)."""
    s = ufl.dev(sigma)
    return ufl.sqrt(3 / 2 * ufl.inner(s, s))


def gradient_symbol() -> Expr:
    """A UFL constant of shape (3, 3) that stands for F in expressions without a mesh."""
    import basix.ufl  # a library, which nothing else here loads

    cell = ufl.Mesh(basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,)))
    return ufl.Constant(cell, (3, 3))
