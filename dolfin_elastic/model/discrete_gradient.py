"""Stress of a time step whose work is the change of the strain energy: a discrete gradient.

A midpoint rule whose stress is S = 2 dpsi/dC at one C keeps the energy of quadratic energies only.
Here C varies along the segment from C0 to C1, and

    S = mean of 2 dpsi/dC over two Gauss points of the segment + s dC,
    s = 2 (psi(F1) - psi(F0) - S_mean : dC/2)/(dC : dC),   dC = C1 - C0,

so that S : dC/2 = psi(F1) - psi(F0) exactly, and s dC vanishes as |dC|^4.  With P = F S, F that of
the mean displacement, P : (F1 - F0) = S : dC/2: the nodal forces do as much work as energy is
stored.  S is symmetric, so they have no moment about the mean position: with the midpoint rule for
velocities, energy, linear and angular momentum are conserved whatever the step.

Gonzalez's own formula takes one point, (C0 + C1)/2.  Its s dC vanishes as |dC|^2 only, and where dC
is small it is a quotient of round-off: stress of 1e-16 psi/|dC|.  With two points s dC is below
that round-off wherever dC : dC < `NEGLIGIBLE`, and is left out there.

psi is known as a function of F.  As it is not changed by rotations, any F with F^T F = C gives its
derivative: S = F^-1 P(F), and the upper triangular one is a closed form (Cholesky).

Sources: O. Gonzalez, Comput. Methods Appl. Mech. Eng. 190 (2000) 1763, (41) and section 4; J. C.
Simo & N. Tarnow, ZAMP 43 (1992) 757 (quadratic energies, where s is zero); A. Harten, P. D. Lax &
B. van Leer, SIAM Rev. 25 (1983) 35 (mean of a gradient along a segment).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.kinematics import right_cauchy_green
from dolfin_elastic.model.materials.law import Law, ModifiedLaw
from dolfin_elastic.model.materials.mixed import Mixed

NEGLIGIBLE = 1e-6
"""dC : dC below which s is left out.  The error of Gauss's rule, psi''''' |dC|^5/4320, is then
below 1e-18 of the modulus, and round-off of psi in s dC at most 1e-13 of it."""

Function = Callable[[Expr], Expr]
"""Of a deformation gradient, shape (3, 3)."""


def triangular(C: Expr, sign: Expr) -> tuple[Expr, Expr]:
    """An upper triangular F with F^T F = C, and its inverse.

    Source: G. H. Golub & C. F. Van Loan, Matrix Computations (2013), section 4.2 (Cholesky).

    Args:
        C: Right Cauchy-Green tensor, shape (3, 3).
        sign: Of det F, 1 or -1.
    """
    a = ufl.sqrt(C[0, 0]) * sign
    d, e = C[0, 1] / a, C[0, 2] / a
    b = ufl.sqrt(C[1, 1] - d * d)
    f = (C[1, 2] - d * e) / b
    c = ufl.sqrt(C[2, 2] - e * e - f * f)
    inverse = [
        [1 / a, -d / (a * b), (d * f - b * e) / (a * b * c)],
        [0, 1 / b, -f / (b * c)],
        [0, 0, 1 / c],
    ]
    return ufl.as_matrix([[a, d, e], [0, b, f], [0, 0, c]]), ufl.as_matrix(inverse)


@dataclass(frozen=True)
class Segment:
    """The way from one deformation to another.

    Attributes:
        F: Mean of both deformation gradients, shape (3, 3).
        D: Their difference, end less start.
    """

    F: Expr
    D: Expr

    @property
    def ends(self) -> tuple[Expr, Expr]:
        """Deformation gradients at start and end."""
        return self.F - self.D / 2, self.F + self.D / 2

    def gradient(self, value: Function, derivative: Function) -> Expr:
        """S of the module for any function that rotations do not change, shape (3, 3).

        Args:
            value: psi(F).
        """
        F, D = self.F, self.D
        dC = F.T * D + D.T * F
        middle, reach = right_cauchy_green(F) + D.T * D / 4, dC / (2 * 3**0.5)
        # An inverted cell stays one, and so do its stretches.
        sign = ufl.conditional(ufl.lt(ufl.det(F), 0.0), -1.0, 1.0)
        mean = 0
        for C in (middle - reach, middle + reach):
            T, inverse = triangular(C, sign)
            mean += inverse * derivative(T) / 2
        start, end = self.ends
        square = ufl.inner(dC, dC)
        missing = value(end) - value(start) - ufl.inner(mean, dC) / 2
        quotient = 2 * missing / ufl.max_value(square, NEGLIGIBLE)
        return mean + ufl.conditional(ufl.gt(square, NEGLIGIBLE), quotient, 0.0) * dC


@dataclass(frozen=True)
class StepLaw(ModifiedLaw):
    """A law over a time step: its arguments F are those of the mean displacement.

    With a pressure p, that of the step, the energy of the shape and the volume strain g have
    discrete gradients each.  The constraint is (g(F0) + g(F1))/2 = p/k, with which p does the work
    that p^2/(2k) of the projected g changes by, and of what cannot be compressed g(F1) = 0.

    Attributes:
        law: The law of a state; it must be frame indifferent, and have an energy.
        start: Deformation gradient at the start of the step, shape (3, 3).
        share: 1 in a step; 0 at a state, where all of this is the law itself.
    """

    law: Law | ModifiedLaw
    start: Expr
    share: Expr

    def _segment(self, F: Expr) -> Segment:
        return Segment(F, 2 * self.share * (F - self.start))

    def energy(self, F: Expr) -> Expr:
        """Energy of a state [J/m^3], not of the step."""
        return self.law.energy(F)

    def stress(self, F: Expr) -> Expr:
        """First Piola-Kirchhoff stress of the step [Pa], see the module."""
        segment, law = self._segment(F), self.law
        if not isinstance(law, Mixed):
            return F * segment.gradient(law.energy, law.stress)
        shape = segment.gradient(law.law.shape_energy, law.law.shape_stress)
        return F * (shape + law.p * segment.gradient(law.volume_strain, law.volume_gradient))

    def gap(self, F: Expr) -> Expr:
        """Residual of the pressure's equation, see the class."""
        assert isinstance(self.law, Mixed)
        law, (start, end) = self.law, self._segment(F).ends
        if law.incompressible:
            return law.volume_strain(end) / (1 + self.share)
        return (law.volume_strain(start) + law.volume_strain(end)) / 2 - law.p * law.compliance
