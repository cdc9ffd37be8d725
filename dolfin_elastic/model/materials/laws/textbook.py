"""The textbook's law: Cauchy stress = Hooke(Green strain)."""

from __future__ import annotations

from typing import ClassVar, Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.kinematics import first_from_cauchy, green_strain
from dolfin_elastic.model.materials.moduli import Isotropic


class Textbook(Isotropic):
    """Cauchy stress by Hooke's law from the Green strain: for teaching and regression only.

    sigma = lmbda tr(E) I + 2 mu E, P = J sigma F^-T.

    This law has NO strain energy, so it gains or loses energy over a closed cycle, and its tangent
    is not symmetric.  It is NOT frame-indifferent: E does not rotate with the body, but sigma
    should.  A rotation of 30 degrees changes the stress of a stretched square by tens of per cent.
    For engineering use `st-venant-kirchhoff`.

    Source: introductory texts on deformable bodies in computer graphics that combine the two
    tensors directly; against it Bonet & Wood (2008), section 6.3.
    """

    law: Literal["textbook"] = "textbook"
    frame_indifferent: ClassVar[bool] = False
    limited: ClassVar[bool] = True
    of_strain_alone: ClassVar[bool] = True
    warning: ClassVar[str] = (
        "the law 'textbook' has no energy and is not frame-indifferent: its stress is wrong as "
        "soon as the body turns; use 'st-venant-kirchhoff' for real work"
    )

    def stress(self, F: Expr) -> Expr:
        """First Piola-Kirchhoff stress, see the class."""
        E = green_strain(F)
        sigma = self.lmbda * ufl.tr(E) * ufl.Identity(F.ufl_shape[0]) + 2 * self.mu * E
        return first_from_cauchy(sigma, F)
