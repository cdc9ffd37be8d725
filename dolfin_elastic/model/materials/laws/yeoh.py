"""Yeoh rubber."""

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


class Yeoh(Isochoric):
    """Yeoh's law for filled rubber.

    psi = c10 (I1 - 3) + c20 (I1 - 3)^2 + c30 (I1 - 3)^3 + K/2 g(J)^2, I1 the first invariant of
    J^-2/3 C.  For filled rubber at large stretches: c20 < 0 softens it at moderate stretches,
    c30 > 0 stiffens it at large ones.  mu = 2 c10.

    Source: O. H. Yeoh, Rubber Chem. Technol. 66 (1993) 754.

    Attributes:
        c10: First constant [Pa].
        c20: Second constant [Pa].
        c30: Third constant [Pa].
    """

    law: Literal["yeoh"] = "yeoh"
    c10: Stress = Field(gt=0)
    c20: Stress = 0.0
    c30: Stress = Field(default=0.0, ge=0)

    barrier: ClassVar[bool] = True
    example: ClassVar[Mapping[str, object]] = {
        "c10": "190 kPa",
        "c20": "-20 kPa",
        "c30": "5 kPa",
        "nu": 0.4,
    }

    def shear(self) -> float:
        """2 c10."""
        return 2 * self.c10

    def destabilising(self) -> tuple[str, ...]:
        """A negative c20, if c30 does not make up for it."""
        return negative(c20=self.c20)

    def _psi(self, first: Expr, second: Expr) -> Expr:
        return first * (self.c10 + first * (self.c20 + first * self.c30))

    def shape_energy(self, F: Expr) -> Expr:
        """A cubic in I1 - 3."""
        return self._psi(*excess_invariants(F))

    def shape_stress(self, F: Expr) -> Expr:
        """Its derivative."""
        return stress_of_invariants(self._psi, F)
