"""Compressible neo-Hookean."""

from __future__ import annotations

from typing import ClassVar, Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.kinematics import (
    cofactor,
    displacement_gradient,
    less_cofactor,
    log1p_less,
    log_volume,
    volume_change,
)
from dolfin_elastic.model.materials.law import SplitLaw
from dolfin_elastic.model.materials.moduli import Isotropic


class NeoHookean(Isotropic, SplitLaw):
    """Compressible neo-Hookean rubber.

    psi = mu/2 (tr F^T F - 3) - mu ln J + lmbda/2 (ln J)^2.

    Source: Bonet & Wood (2008), (6.29).
    """

    law: Literal["neo-hookean"] = "neo-hookean"
    barrier: ClassVar[bool] = True

    volume_modulus: ClassVar[str] = "lmbda"
    strain_of_volume: ClassVar[bool] = True

    def shape_energy(self, F: Expr) -> Expr:
        """mu/2 (tr F^T F - 3) - mu ln J, without the terms of first order in H = F - I."""
        H = displacement_gradient(F)
        squares = ufl.inner(H, H) - ufl.tr(H) ** 2 + ufl.inner(H.T, H) - 2 * ufl.det(H)
        return self.mu * (squares / 2 - log1p_less(volume_change(F), ufl.det(F)))

    def shape_stress(self, F: Expr) -> Expr:
        """mu (F - F^-T) = mu (F - cof F + (J - 1)/J cof F)."""
        return self.mu * (less_cofactor(F) + volume_change(F) / ufl.det(F) * cofactor(F))

    def volume_strain(self, F: Expr) -> Expr:
        """ln J."""
        return log_volume(F)

    def volume_gradient(self, F: Expr) -> Expr:
        """F^-T."""
        return cofactor(F) / ufl.det(F)
