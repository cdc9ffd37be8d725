"""Growth and thermal expansion: laws about a natural state that is not the reference state.

F = Fe Fg with growth Fg and elastic part Fe, on which the stress depends.  Per reference volume
psi(F) = Jg psi_law(F Fg^-1) and P = Jg P_law(F Fg^-1) Fg^-T.  Where the law is linear, strains
add up: psi(F) = psi_law(F - (Fg - I)).

Source: Rodriguez, Hoger & McCulloch, J. Biomech. 27 (1994), (6) and (16); small strains:
Boley & Weiner, Theory of Thermal Stresses (1960), (1.12.14).
"""

from __future__ import annotations

from dataclasses import dataclass

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.kinematics import deformation_from, displacement_gradient
from dolfin_elastic.model.materials.law import Law, ModifiedLaw, once
from dolfin_elastic.model.materials.mixed import Mixed


@dataclass(frozen=True)
class GrownLaw(ModifiedLaw):
    """A law, with or without a pressure field, about a grown natural state.

    Attributes:
        law: The law about its own natural state.
        growth: Fg, a UFL tensor of shape (3, 3).
    """

    law: Law | ModifiedLaw
    growth: Expr

    @once
    def elastic(self, F: Expr) -> Expr:
        """Elastic part Fe of a deformation gradient, shape (3, 3)."""
        # F Fg^-1 - I = (F - Fg) Fg^-1
        H = displacement_gradient(F) - displacement_gradient(self.growth)
        return deformation_from(H if self.law.linear else H * ufl.inv(self.growth))

    @property
    def volume(self) -> Expr:
        """Jg, grown over reference volume; 1 to the order of small strains."""
        return 1 if self.law.linear else ufl.det(self.growth)

    def energy(self, F: Expr) -> Expr:
        """Energy per reference volume [J/m^3]."""
        return self.volume * self.law.energy(self.elastic(F))

    def stress(self, F: Expr) -> Expr:
        """First Piola-Kirchhoff stress [Pa]."""
        P = self.law.stress(self.elastic(F))
        return P if self.law.linear else self.volume * P * ufl.inv(self.growth).T

    def strain(self, F: Expr) -> Expr:
        """That of the elastic part, without growth."""
        return self.law.strain(self.elastic(F))

    def gap(self, F: Expr) -> Expr:
        """Residual of the pressure's equation, see `Mixed.gap`."""
        assert isinstance(self.law, Mixed)
        return self.volume * self.law.gap(self.elastic(F))


def grown_volume(response: Law | ModifiedLaw) -> Expr:
    """Grown over reference volume of a law with or without growth."""
    return ufl.as_ufl(response.volume if isinstance(response, GrownLaw) else 1.0)
