"""The perturbed Lagrangian: a law whose volumetric part is carried by a pressure field."""

from __future__ import annotations

from dataclasses import dataclass

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.materials.law import ModifiedLaw, SplitLaw


@dataclass(frozen=True)
class Mixed(ModifiedLaw):
    """A split law with a pressure p that is an unknown.

    psi(F, p) = shape_energy(F) + p g(F) - p^2/(2k), g the law's volume strain.  Where psi is
    stationary in p, p = k g, and psi is the law's own energy.  In exactly incompressible bodies
    1/k is 0 and p enforces `SplitLaw.incompressibility`, J - 1 = 0 for all laws whose g depends on
    J alone.  p is positive in tension.

    Source: Bonet & Wood (2008), section 8.6.4; Brezzi & Fortin, Mixed and Hybrid Finite Element
    Methods (1991), section VI.

    Attributes:
        law: The law, with UFL constants for its numbers.
        p: Pressure [Pa], a UFL expression.
        compliance: 1/k [1/Pa].
        incompressible: 1/k is exactly zero.
    """

    law: SplitLaw
    p: Expr
    compliance: Expr
    incompressible: bool = False

    def volume_strain(self, F: Expr) -> Expr:
        """Conjugate of p: the law's volume strain, or its incompressibility constraint."""
        return self.law.incompressibility(F) if self.incompressible else self.law.volume_strain(F)

    def volume_gradient(self, F: Expr) -> Expr:
        """Derivative of `volume_strain` with respect to F."""
        law = self.law
        exact = self.incompressible
        return law.incompressibility_gradient(F) if exact else law.volume_gradient(F)

    def gap(self, F: Expr) -> Expr:
        """Residual of the pressure's equation: g - p/k."""
        return self.volume_strain(F) - self.p * self.compliance

    def energy(self, F: Expr) -> Expr:
        """Energy per reference volume [J/m^3], see the class."""
        shape, g = self.law.shape_energy(F), self.volume_strain(F)
        return shape + self.p * g - self.p**2 * self.compliance / 2

    def stress(self, F: Expr) -> Expr:
        """First Piola-Kirchhoff stress [Pa], the derivative of the energy at fixed p."""
        return self.law.shape_stress(F) + self.p * self.volume_gradient(F)


def variance(p: Expr, q: Expr, J: Expr) -> Expr:
    """Covariance of two linear functions over a cell: mean of (p - mean p)(q - mean q).

    It is grad p . C grad q with the covariance C of a point anywhere in the cell, which for the
    reference simplex of d dimensions is (I - 1/(d + 1))/((d + 1)(d + 2)).

    Args:
        J: Jacobian dx/dX of the cell's map, shape (dim, dim).
    """
    d = J.ufl_shape[0]
    a, b = ufl.dot(J.T, ufl.grad(p)), ufl.dot(J.T, ufl.grad(q))
    product = ufl.inner(a, b) - sum(a) * sum(b) / (d + 1)
    return product / ((d + 1) * (d + 2))
