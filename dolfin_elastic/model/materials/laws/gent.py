"""Gent rubber."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

import ufl
from pydantic import Field
from ufl.core.expr import Expr

from dolfin_elastic.core.units import Number, Stress
from dolfin_elastic.model.kinematics import log1p
from dolfin_elastic.model.materials.isochoric import (
    Isochoric,
    excess_invariants,
    stress_of_invariants,
)


class Gent(Isochoric):
    """Gent's rubber with a limit of extension.

    psi = -mu limit/2 ln(1 - (I1 - 3)/limit) + K/2 g(J)^2, I1 the first invariant of J^-2/3 C.  For
    rubber and soft tissue that stiffen without bound: I1 - 3 stays below the limit.  Load steps
    must be small near it.  For an infinite limit the law is neo-Hookean.

    Source: A. N. Gent, Rubber Chem. Technol. 69 (1996) 59.

    Attributes:
        mu: Shear modulus at small strains [Pa].
        limit: Upper bound of I1 - 3; for rubber 30 to 100.
    """

    law: Literal["gent"] = "gent"
    mu: Stress = Field(gt=0)
    limit: Number = Field(gt=0)

    barrier: ClassVar[bool] = True
    example: ClassVar[Mapping[str, object]] = {"mu": "385 kPa", "limit": 60, "nu": 0.4}

    def shear(self) -> float:
        """See the class."""
        return self.mu

    def shape_energy(self, F: Expr) -> Expr:
        """-mu limit/2 ln(1 - (I1 - 3)/limit)."""
        return -self.mu * self.limit / 2 * log1p(-excess_invariants(F)[0] / self.limit)

    def shape_stress(self, F: Expr) -> Expr:
        """Its derivative."""

        def psi(first: Expr, second: Expr) -> Expr:
            """The energy with a logarithm whose derivative has no condition.

            Args:
                first: I1 - 3.
                second: I2 - 3.
            """
            return -self.mu * self.limit / 2 * ufl.ln(1 - first / self.limit)

        return stress_of_invariants(psi, F)
