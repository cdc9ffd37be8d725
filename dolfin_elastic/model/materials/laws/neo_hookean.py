"""Compressible neo-Hookean."""

from __future__ import annotations

from typing import ClassVar, Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.materials.law import Isotropic, SplitLaw


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
        """mu/2 (tr F^T F - 3) - mu ln J."""
        return self.mu / 2 * (ufl.inner(F, F) - 3) - self.mu * ufl.ln(ufl.det(F))

    def volume_strain(self, F: Expr) -> Expr:
        """ln J."""
        return ufl.ln(ufl.det(F))
