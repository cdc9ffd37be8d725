"""Blatz-Ko foam rubber."""

from __future__ import annotations

from typing import ClassVar, Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.model.kinematics import (
    cofactor,
    displacement_gradient,
    expm1,
    expm1_less,
    green_strain,
    less_cofactor,
    log1p_less,
    log_volume,
    volume_change,
)
from dolfin_elastic.model.materials.moduli import Isotropic
from dolfin_elastic.model.materials.spatial import Range


class BlatzKo(Isotropic):
    """Compressible foam rubber.

    psi = mu/2 (I2/J^2 - 3) + mu^2/lmbda (J^(lmbda/mu) - 1), I2 the second invariant of C.  For
    nu = 1/4, psi = mu/2 (I2/J^2 + 2 J - 5).  For foamed rubber with nu well below 0.5 at large
    strains.

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
        # I2/J^2 = tr C^-1 = 3 - 2 tr E + C^-1 : (2 E)^2, whose part of first order in H = F - I is
        # that of the volume.  The logarithm refuses J < 0, where a power of J could be finite.
        E, H, inverse, j = green_strain(F), displacement_gradient(F), ufl.inv(F), volume_change(F)
        drawn = E * inverse
        rest = (ufl.tr(H) ** 2 - ufl.inner(H.T, H) - ufl.inner(H, H)) / 2 + ufl.det(H)  # j - tr E
        ratio, log = self.lmbda / self.mu, log1p_less(j, ufl.det(F))
        volume = expm1_less(ratio * (log + j)) / ratio + log
        return self.mu * (rest + 2 * ufl.inner(drawn, drawn) + volume)

    def stress(self, F: Expr) -> Expr:
        """mu F^-T (J^(lmbda/mu) I - C^-1), with C^-1 - I from Y = F^-T - I.

        J Y = cof F - J I = F - (F - cof F) - J I.
        """
        H, J, j = displacement_gradient(F), ufl.det(F), volume_change(F)
        Y = (H - less_cofactor(F) - j * ufl.Identity(3)) / J
        volume = expm1(self.lmbda / self.mu * log_volume(F))
        rest = volume * ufl.Identity(3) - (Y + Y.T + Y.T * Y)
        return self.mu / J * (cofactor(F) * rest)
