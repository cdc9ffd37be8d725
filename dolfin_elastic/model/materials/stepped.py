"""Laws that remember, over one time step: functions of F and of what was committed before."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

from ufl.core.expr import Expr

from dolfin_elastic.model.materials.law import Law, ModifiedLaw, SplitLaw
from dolfin_elastic.model.materials.memory import OverStep


@dataclass(frozen=True)
class SteppedLaw(OverStep, ModifiedLaw):
    """A law over a time step that begins with a history.

    Its `energy` is what is stored at the end of the step and can be had back.

    Attributes:
        law: The law that remembers.
        past: What its stress depends on beside F, by name, see `Memory.seen`.
        step: Constants of the step, see `Memory.step`.
    """

    law: Law
    past: Mapping[str, Expr]
    step: Mapping[str, Expr]


@dataclass(frozen=True)
class SteppedSplitLaw(SteppedLaw):
    """The same of a split law whose volumetric part remembers nothing; it is one for `Mixed`."""

    law: SplitLaw

    @abstractmethod
    def shape_stress(self, F: Expr) -> Expr:
        """See `SplitLaw`, over the step."""

    @abstractmethod
    def shape_energy(self, F: Expr) -> Expr:
        """See `SplitLaw`, at the end of the step."""

    def energy(self, F: Expr) -> Expr:
        """Energy per reference volume that can be had back [J/m^3]."""
        k = getattr(self.law, self.law.volume_modulus)
        return self.shape_energy(F) + k / 2 * self.law.volume_strain(F) ** 2

    def stress(self, F: Expr) -> Expr:
        """First Piola-Kirchhoff stress [Pa] over the step."""
        k = getattr(self.law, self.law.volume_modulus)
        return self.shape_stress(F) + k * self.law.volume_stress(F)

    def volume_strain(self, F: Expr) -> Expr:
        """See `SplitLaw`."""
        return self.law.volume_strain(F)

    def volume_gradient(self, F: Expr) -> Expr:
        """See `SplitLaw`."""
        return self.law.volume_gradient(F)

    def incompressibility(self, F: Expr) -> Expr:
        """See `SplitLaw`."""
        return self.law.incompressibility(F)

    def incompressibility_gradient(self, F: Expr) -> Expr:
        """See `SplitLaw`."""
        return self.law.incompressibility_gradient(F)


def stepped(law: Law | ModifiedLaw) -> SteppedLaw | None:
    """The law over a step behind what a pressure field or growth has made of it; None without."""
    while isinstance(law, ModifiedLaw) and not isinstance(law, SteppedLaw):
        law = law.law
    return law if isinstance(law, SteppedLaw) else None
