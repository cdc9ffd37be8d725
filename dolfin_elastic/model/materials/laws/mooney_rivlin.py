"""Mooney-Rivlin rubber."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

from pydantic import Field
from ufl.core.expr import Expr

from dolfin_elastic.core.units import Stress
from dolfin_elastic.model.materials.isochoric import (
    Isochoric,
    excess_invariants,
    stress_of_invariants,
)
from dolfin_elastic.model.materials.law import negative


class MooneyRivlin(Isochoric):
    """Mooney-Rivlin rubber.

    psi = c10 (I1 - 3) + c01 (I2 - 3) + K/2 g(J)^2, I1 and I2 the invariants of J^-2/3 C.  For
    rubber at moderate stretches, up to about 2.  A neo-Hookean law fitted to shear is too stiff in
    tension there.  mu = 2 (c10 + c01).

    Source: R. S. Rivlin and D. W. Saunders, Phil. Trans. R. Soc. A 243 (1951) 251; Bonet & Wood
    (2008), section 6.5.

    Attributes:
        c10: Constant of the first invariant [Pa].
        c01: Constant of the second invariant [Pa].
    """

    law: Literal["mooney-rivlin"] = "mooney-rivlin"
    c10: Stress
    c01: Stress = Field(ge=0)

    barrier: ClassVar[bool] = True
    example: ClassVar[Mapping[str, object]] = {"c10": "150 kPa", "c01": "40 kPa", "nu": 0.4}

    def shear(self) -> float:
        """2 (c10 + c01)."""
        return 2 * (self.c10 + self.c01)

    def destabilising(self) -> tuple[str, ...]:
        """A negative c10, against which c01 holds only where stretches are moderate."""
        return negative(c10=self.c10)

    def _psi(self, first: Expr, second: Expr) -> Expr:
        return self.c10 * first + self.c01 * second

    def shape_energy(self, F: Expr) -> Expr:
        """c10 (I1 - 3) + c01 (I2 - 3)."""
        return self._psi(*excess_invariants(F))

    def shape_stress(self, F: Expr) -> Expr:
        """Its derivative."""
        return stress_of_invariants(self._psi, F)
