"""A law that remembers without time: damage by the largest energy so far, in closed form.

psi = exp(-kappa/limit) psi0, kappa the largest psi0 so far: J. C. Simo, Comput. Methods Appl. Mech.
Eng. 60 (1987) 153, section 2.  Along any path on which psi0 grows the stress does not depend on the
steps.  Beside kappa it remembers the number of steps and the last strain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import ufl
from ufl.core.expr import Expr

from dolfin_elastic import LinearElastic, NeoHookean
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.memory import Memory, OverStep, Variable
from dolfin_elastic.model.materials.stepped import SteppedLaw


@dataclass(frozen=True)
class DamagedOverStep(SteppedLaw):
    """The law over a step; `past` has kappa [J/m^3], count and strain."""

    limit: float

    def _kappa(self, F: Expr) -> Expr:
        energy = self.law.energy(F)
        return ufl.conditional(ufl.gt(energy, self.past["kappa"]), energy, self.past["kappa"])

    def _left(self, F: Expr) -> Expr:
        return ufl.exp(-self._kappa(F) / self.limit)

    def energy(self, F: Expr) -> Expr:
        return self._left(F) * self.law.energy(F)

    def stress(self, F: Expr) -> Expr:
        return self._left(F) * self.law.stress(F)

    def lost(self, F: Expr) -> Expr:
        kappa = self._kappa(F)
        return self.limit - (self.limit + kappa) * ufl.exp(-kappa / self.limit)

    def at_end(self, F: Expr) -> dict[str, Expr]:
        strain = ufl.sym(self.law.strain(F))
        return {"kappa": self._kappa(F), "count": self.past["count"] + 1, "strain_before": strain}


class Damage(Memory):
    """What it remembers."""

    variables = (Variable("kappa"), Variable("count"), Variable("strain_before", "symmetric"))
    timed = False

    def __init__(self, law: Law, limit: float) -> None:
        self._law, self._limit = law, limit

    def over_step(self, past: Mapping[str, Expr], step: Mapping[str, Expr]) -> OverStep:
        return DamagedOverStep(self._law, past, step, self._limit)


class Damaged(LinearElastic):
    """Of small strains."""

    limit: float = 1.0

    @property
    def memory(self) -> Memory:
        return Damage(self, self.limit)


class DamagedRubber(NeoHookean):
    """Of large strains."""

    limit: float = 1.0

    @property
    def memory(self) -> Memory:
        return Damage(self, self.limit)
