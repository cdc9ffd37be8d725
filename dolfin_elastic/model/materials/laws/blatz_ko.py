"""Blatz-Ko foam rubber."""

from __future__ import annotations

from typing import ClassVar, Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.materials.law import Isotropic
from dolfin_elastic.model.materials.spatial import Range


class BlatzKo(Isotropic):
    """Compressible foam rubber.

    psi = mu/2 (I2/J^2 - 3) + mu^2/lmbda (J^(lmbda/mu) - 1), I2 the second invariant of C; for
    nu = 1/4 it is mu/2 (I2/J^2 + 2 J - 5).  For foamed rubber, nu well below 0.5, in large strains.

    Source: P. J. Blatz and W. L. Ko, Trans. Soc. Rheology 6 (1962) 223, with f = 0.
    """

    law: Literal["blatz-ko"] = "blatz-ko"

    barrier: ClassVar[bool] = True

    def model_post_init(self, context: object) -> None:
        """Completes the moduli; a foam gets thinner when it is drawn."""
        super().model_post_init(context)
        if not self.spatial_constants() and not 0 < self.lmbda < float("inf"):
            raise InputError(
                f"the foam's Poisson's ratio is {self.nu:g}",
                where="nu",
                expected="nu must lie above 0 and below 0.5 (foam: about 0.25)",
            )

    @classmethod
    def ranges(cls) -> dict[str, Range]:
        """See `Law.ranges`."""
        return {**super().ranges(), "nu": Range(low=0.0, high=0.5)}

    def energy(self, F: Expr) -> Expr:
        """See the class."""
        C, J = F.T * F, ufl.det(F)
        I2 = (ufl.tr(C) ** 2 - ufl.inner(C, C)) / 2
        # The logarithm refuses J < 0, where a whole power of J would be finite.
        volume = ufl.exp(self.lmbda / self.mu * ufl.ln(J)) - 1
        return self.mu / 2 * (I2 / J**2 - 3) + self.mu**2 / self.lmbda * volume
