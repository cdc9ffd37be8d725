"""St. Venant-Kirchhoff."""

from __future__ import annotations

from typing import ClassVar, Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.kinematics import green_strain
from dolfin_elastic.model.materials.law import SplitLaw
from dolfin_elastic.model.materials.moduli import Isotropic


class StVenantKirchhoff(Isotropic, SplitLaw):
    """Hooke's law between the second Piola-Kirchhoff stress and the Green strain.

    psi = mu E:E + lmbda/2 (tr E)^2.  For large rotations with small strains.  It softens in
    compression, with a limit point at a stretch of 1/sqrt(3), and does not resist inversion.

    Source: Bonet & Wood (2008), (6.27)-(6.28).
    """

    law: Literal["st-venant-kirchhoff"] = "st-venant-kirchhoff"

    volume_modulus: ClassVar[str] = "lmbda"
    limited: ClassVar[bool] = True
    of_strain_alone: ClassVar[bool] = True

    def shape_energy(self, F: Expr) -> Expr:
        """mu E:E."""
        E = green_strain(F)
        return self.mu * ufl.inner(E, E)

    def volume_strain(self, F: Expr) -> Expr:
        """tr E."""
        return ufl.tr(green_strain(F))
