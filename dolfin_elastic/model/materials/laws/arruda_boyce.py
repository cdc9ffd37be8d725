"""Arruda-Boyce rubber."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, Literal

from pydantic import Field
from ufl.core.expr import Expr

from dolfin_elastic.core.units import Number, Stress
from dolfin_elastic.model.kinematics import polynomial
from dolfin_elastic.model.materials.isochoric import (
    Isochoric,
    excess_invariants,
    stress_of_invariants,
)

SERIES = (1 / 2, 1 / 20, 11 / 1050, 19 / 7000, 519 / 673750)
"""Of the inverse Langevin function, integrated."""


class ArrudaBoyce(Isochoric):
    """The eight-chain model of Arruda and Boyce.

    psi = mu sum_i C_i/limit^(2i-2) (I1^i - 3^i) + K/2 g(J)^2, i = 1...5,
    C = 1/2, 1/20, 11/1050, 19/7000, 519/673750, I1 the first invariant of J^-2/3 C.  For rubber up
    to the stretch at which its molecular chains are straight.  Both constants have a physical
    meaning.  The shear modulus at small strains is
    mu (1 + 3/(5 limit^2) + 99/(175 limit^4) + ...).

    Source: E. M. Arruda and M. C. Boyce, J. Mech. Phys. Solids 41 (1993) 389.

    Attributes:
        mu: Rubbery modulus [Pa].
        limit: Stretch at which chains are straight, above 1.
    """

    law: Literal["arruda-boyce"] = "arruda-boyce"
    mu: Stress = Field(gt=0)
    limit: Number = Field(gt=1)

    barrier: ClassVar[bool] = True
    example: ClassVar[Mapping[str, object]] = {"mu": "350 kPa", "limit": 2.8, "nu": 0.4}

    def shear(self) -> float:
        """2 dpsi/dI1 at I1 = 3."""
        terms = (i * c * (3 / self.limit**2) ** (i - 1) for i, c in enumerate(SERIES, start=1))
        return 2 * self.mu * sum(terms)

    def _psi(self, first: Expr, second: Expr) -> Expr:
        """The first five terms, I1^i - 3^i as a polynomial in I1 - 3 (binomial theorem)."""
        chains = 1 / self.limit**2
        powers = [
            sum(
                SERIES[i - 1] * math.comb(i, k) * 3 ** (i - k) * chains ** (i - 1)
                for i in range(k, len(SERIES) + 1)
            )
            for k in range(1, len(SERIES) + 1)
        ]
        return self.mu * polynomial(powers, first)

    def shape_energy(self, F: Expr) -> Expr:
        """The first five terms."""
        return self._psi(*excess_invariants(F))

    def shape_stress(self, F: Expr) -> Expr:
        """Its derivative."""
        return stress_of_invariants(self._psi, F)
