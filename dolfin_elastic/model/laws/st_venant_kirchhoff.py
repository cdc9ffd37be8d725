"""St. Venant-Kirchhoff."""

from __future__ import annotations

from typing import Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.kinematics import green_strain
from dolfin_elastic.model.law import Isotropic


class StVenantKirchhoff(Isotropic):
    """Hooke's law between the second Piola-Kirchhoff stress and the Green strain.

    psi = mu E:E + lmbda/2 (tr E)^2.  For large rotations with small strains; it softens in
    compression (limit point at a stretch of 1/sqrt(3)) and does not resist inversion.

    Source: Bonet & Wood (2008), (6.27)-(6.28).
    """

    law: Literal["st-venant-kirchhoff"] = "st-venant-kirchhoff"

    def energy(self, F: Expr) -> Expr:
        """See the class."""
        E = green_strain(F)
        return self.mu * ufl.inner(E, E) + self.lmbda / 2 * ufl.tr(E) ** 2
