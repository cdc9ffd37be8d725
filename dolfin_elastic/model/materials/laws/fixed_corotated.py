"""Fixed corotated elasticity."""

from __future__ import annotations

from typing import ClassVar, Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.kinematics import cofactor, volume_change
from dolfin_elastic.model.materials.law import SplitLaw, once
from dolfin_elastic.model.materials.moduli import Isotropic
from dolfin_elastic.model.materials.spectral import Polar, polar


class FixedCorotated(Isotropic, SplitLaw):
    """Corotated elasticity with a volumetric part in terms of J.

    psi = mu sum_i (s_i - 1)^2 + lmbda/2 (J - 1)^2, s the singular values of F.  Where J is
    negative, the smallest singular value is negative.  For large deformations that must recover
    from inverted elements, as in animation.  The energy is finite and smooth for inverted elements,
    so it does not resist inversion.

    Source: A. Stomakhin, R. Howes, C. Schroeder and J. Teran, Eurographics/ACM Symposium on
    Computer Animation (2012) 25, section 4.
    """

    law: Literal["fixed-corotated"] = "fixed-corotated"

    survives_inversion: ClassVar[bool] = True
    volume_modulus: ClassVar[str] = "lmbda"
    strain_of_volume: ClassVar[bool] = True

    @once
    def _polar(self, F: Expr) -> Polar:
        return polar(F)

    def shape_energy(self, F: Expr) -> Expr:
        """mu (F - R):(F - R)."""
        stretching = self._polar(F).stretching
        return self.mu * ufl.inner(stretching, stretching)

    def shape_stress(self, F: Expr) -> Expr:
        """2 mu (F - R)."""
        return 2 * self.mu * self._polar(F).stretching

    @property
    def curved_strain(self) -> bool:
        """J - 1 is affine."""
        return False

    def volume_strain(self, F: Expr) -> Expr:
        """J - 1."""
        return volume_change(F)

    def volume_gradient(self, F: Expr) -> Expr:
        """Cof F."""
        return cofactor(F)

    def strain(self, F: Expr) -> Expr:
        """Biot's strain U - I."""
        result = self._polar(F)
        return result.R.T * result.stretching
