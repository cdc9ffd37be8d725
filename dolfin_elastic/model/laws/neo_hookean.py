"""Compressible neo-Hookean."""

from __future__ import annotations

from typing import ClassVar, Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.law import Isotropic


class NeoHookean(Isotropic):
    """Compressible neo-Hookean rubber.

    psi = mu/2 (tr F^T F - 3) - mu ln J + lmbda/2 (ln J)^2.

    Source: Bonet & Wood (2008), (6.29).
    """

    law: Literal["neo-hookean"] = "neo-hookean"
    barrier: ClassVar[bool] = True

    def energy(self, F: Expr) -> Expr:
        """See the class."""
        log_J = ufl.ln(ufl.det(F))
        return self.mu / 2 * (ufl.inner(F, F) - 3) - self.mu * log_J + self.lmbda / 2 * log_J**2
