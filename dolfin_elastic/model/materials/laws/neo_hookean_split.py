"""Neo-Hookean rubber, isochoric-volumetric."""

from __future__ import annotations

from typing import ClassVar, Literal

from ufl.core.expr import Expr

from dolfin_elastic.model.materials.isochoric import (
    Volumetric,
    excess_invariants,
    stress_of_invariants,
)
from dolfin_elastic.model.materials.moduli import Isotropic


class NeoHookeanSplit(Isotropic, Volumetric):
    """Neo-Hookean rubber whose pressure depends on the volume alone.

    psi = mu/2 (I1 - 3) + K/2 g(J)^2, I1 the first invariant of J^-2/3 C.  The
    volumetric part is K/4 (J^2 - 1 - 2 ln J) by default.  For nearly incompressible rubber, and for
    comparison with programs that split the energy in this way.

    Source: J. C. Simo and R. L. Taylor, Comput. Methods Appl. Mech. Eng. 35 (1982) 107.
    """

    law: Literal["neo-hookean-split"] = "neo-hookean-split"

    barrier: ClassVar[bool] = True

    def _psi(self, first: Expr, second: Expr) -> Expr:
        return self.mu / 2 * first

    def shape_energy(self, F: Expr) -> Expr:
        """mu/2 (I1 - 3)."""
        return self._psi(*excess_invariants(F))

    def shape_stress(self, F: Expr) -> Expr:
        """Its derivative."""
        return stress_of_invariants(self._psi, F)
