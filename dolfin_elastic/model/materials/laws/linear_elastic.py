"""Linear elasticity."""

from __future__ import annotations

from typing import ClassVar, Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.kinematics import infinitesimal_strain
from dolfin_elastic.model.materials.law import SplitLaw
from dolfin_elastic.model.materials.moduli import Isotropic


class LinearElastic(Isotropic, SplitLaw):
    """Hooke's law for small strains.

    psi = mu eps:eps + lmbda/2 (tr eps)^2, eps the infinitesimal strain.  Changes of
    geometry are neglected: valid for strains and rotations up to a few per cent.

    Source: Landau & Lifshitz, Theory of Elasticity, (4.1).
    """

    law: Literal["linear-elastic"] = "linear-elastic"
    linear: ClassVar[bool] = True
    frame_indifferent: ClassVar[bool] = False

    volume_modulus: ClassVar[str] = "lmbda"

    @property
    def surely_stiff(self) -> bool:
        """See `Law`; a law that is derived from this one may be anything."""
        return type(self) is LinearElastic

    def shape_energy(self, F: Expr) -> Expr:
        """mu eps:eps."""
        eps = infinitesimal_strain(F)
        return self.mu * ufl.inner(eps, eps)

    def volume_strain(self, F: Expr) -> Expr:
        """tr eps."""
        return ufl.tr(infinitesimal_strain(F))
