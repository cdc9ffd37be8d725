"""Hencky solid."""

from __future__ import annotations

from typing import ClassVar, Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.kinematics import cofactor, log_volume
from dolfin_elastic.model.materials.law import SplitLaw
from dolfin_elastic.model.materials.moduli import Isotropic
from dolfin_elastic.model.materials.spectral import (
    Shape,
    isochoric_energy,
    isochoric_stress,
    log_series,
    square_of_log_series,
)


class Logarithmic(Isotropic, SplitLaw):
    """A law with Hooke's constants between Kirchhoff stress and logarithmic strain: `Hencky`."""

    barrier: ClassVar[bool] = True
    strain_of_volume: ClassVar[bool] = True

    @property
    def isochoric_shape(self) -> bool:
        """See `Law`."""
        return True

    def _psi(self, shape: Shape) -> Expr:
        squares = shape.excess(lambda square: ufl.ln(square) ** 2, square_of_log_series())
        return self.mu * (squares / 4 - shape.of_d(ufl.ln, log_series()) ** 2 / 12)

    def shape_energy(self, F: Expr) -> Expr:
        """mu sum_i (ln (l_i J^-1/3))^2."""
        return isochoric_energy(self._psi, F)

    def shape_stress(self, F: Expr) -> Expr:
        """Its derivative."""
        return isochoric_stress(self._psi, F)

    def volume_strain(self, F: Expr) -> Expr:
        """ln J."""
        return log_volume(F)

    def volume_gradient(self, F: Expr) -> Expr:
        """F^-T."""
        return cofactor(F) / ufl.det(F)

    def strain(self, F: Expr) -> Expr:
        """The logarithmic strain ln U, which F^T P = 2 mu ln U + lmbda ln J I gives."""
        shape = ufl.sym(F.T * self.shape_stress(F)) / (2 * self.mu)
        return shape + self.volume_strain(F) / 3 * ufl.Identity(3)


class Hencky(Logarithmic):
    """Hooke's law between the Kirchhoff stress and the logarithmic strain.

    psi = mu sum_i (ln l_i)^2 + lmbda/2 (ln J)^2, l the principal stretches.  The program uses
    the equal form mu sum_i (ln (l_i J^-1/3))^2 + K/2 (ln J)^2.  For metals and polymers at moderate
    strains: Hooke's constants hold well beyond small strains.  It softens at stretches above e.

    Source: L. Anand, J. Appl. Mech. 46 (1979) 78; Bonet & Wood (2008), section 6.6.
    """

    law: Literal["hencky"] = "hencky"
