"""Relaxation of the deviatoric stress by a Prony series.

The constants of the law are those of a sudden load; with the time the deviatoric stress falls as
G(t) = 1 - sum g (1 - exp(-t/tau)) says.  Each branch has the overstress h on the isochoric strain,
h' = S' - h/tau, S the second Piola-Kirchhoff stress of the law on J^-2/3 C (of linear laws the
deviatoric stress).  Over a step with x = dt/tau, e = exp(-x) and f = (1 - e)/x, exact where S is
linear in time,

    h <- e h + f (S - S0),        stress of the step = (1 - sum g (1 - f)) S + H,
    H = sum g (e h - f S0),

so that the stress is a function of F and of one tensor H that is the same for the whole step; its
derivative by F is symmetric.

Source: J. C. Simo, Comput. Methods Appl. Mech. Eng. 60 (1987) 153; Simo & Hughes, Computational
Inelasticity (1998), section 10.3; f: R. L. Taylor, K. S. Pister and G. L. Goudreau, Int. J. Numer.
Methods Eng. 2 (1970) 45.  H acts on J^-2/3 C here, which leaves the pressure to the volume.
"""

from __future__ import annotations

from dataclasses import dataclass

import ufl
from pydantic import Field, field_validator
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import Record, WhenGiven
from dolfin_elastic.core.units import Number, Time
from dolfin_elastic.model.kinematics import cofactor, infinitesimal_strain
from dolfin_elastic.model.materials.law import ModifiedLaw, SplitLaw, once


class PronyTerm(Record):
    """One term of a Prony series.

    Attributes:
        g: Fraction of the instantaneous deviatoric stress that relaxes.
        tau: Time in which this fraction falls to 1/e [s].
    """

    g: Number = Field(gt=0, lt=1)
    tau: Time = Field(gt=0)


class Relaxing(SplitLaw):
    """A law whose deviatoric stress may relax.

    Attributes:
        prony: Terms of a Prony series, each a fraction g and a time tau. After a sudden strain the
            deviatoric stress is multiplied by 1 - sum g (1 - exp(-t/tau)). The other constants are
            instantaneous values. In statics the load factor is the time in seconds.
    """

    prony: tuple[WhenGiven[PronyTerm], ...] = ()

    @field_validator("prony")
    @classmethod
    def _lasts(cls, terms: tuple[PronyTerm, ...]) -> tuple[PronyTerm, ...]:
        if not terms:
            raise InputError(
                "a Prony series without terms: nothing would relax",
                expected='expected for example [{g = 0.3, tau = "1 s"}], or no `prony`',
            )
        relaxing = sum(term.g for term in terms)
        if relaxing >= 1:
            raise InputError(
                f"the fractions g sum up to {relaxing:.6g}: nothing would hold the shape for long",
                expected="fractions whose sum is below 1",
            )
        return terms

    @property
    def relaxes(self) -> bool:
        """See `Law`."""
        return bool(self.prony)

    @property
    def lasting(self) -> float:
        """Share of the shear stiffness that stays for ever, 1 - sum g."""
        return 1.0 - sum(term.g for term in self.prony)


def overstress(law: SplitLaw, F: Expr) -> Expr:
    """The stress that relaxes, S of the module: shape (3, 3) [Pa], symmetric.

    Args:
        F: Deformation gradient, shape (3, 3).
    """
    P = law.shape_stress(F)
    return ufl.dev(P) if law.linear else ufl.det(F) ** (-1 / 3) * cofactor(F).T * P


@dataclass(frozen=True)
class Relaxed(ModifiedLaw):
    """A law over a time step that begins with a history; a split law for `Mixed`.

    Attributes:
        law: The law of a sudden strain.
        instant: Factor of its deviatoric stress in the step, 1 - sum g (1 - f).
        lasting: The same after a long time, 1 - sum g.
        past: H of the module, shape (3, 3) [Pa].
    """

    law: SplitLaw
    instant: Expr
    lasting: Expr
    past: Expr

    @once
    def _shape(self, F: Expr) -> tuple[Expr, Expr]:
        """The law's stress without volumetric part, and its deviatoric part [Pa]."""
        P = self.law.shape_stress(F)
        return P, ufl.dev(P) if self.law.linear else P

    @once
    def _of_the_past(self, F: Expr) -> Expr:
        """Stress of H [Pa]: the derivative of H : J^-2/3 C/2, of linear laws of H : dev eps."""
        if self.law.linear:
            return ufl.dev(self.past)
        FH, J = F * self.past, ufl.det(F)
        return J ** (-2 / 3) * (FH - ufl.inner(FH, F) / (3 * J) * cofactor(F))

    def shape_stress(self, F: Expr) -> Expr:
        """See `SplitLaw`, over the step."""
        P, relaxing = self._shape(F)
        return P + (self.instant - 1) * relaxing + self._of_the_past(F)

    def branch_stress(self, F: Expr) -> Expr:
        """First Piola-Kirchhoff stress of all branches [Pa]: what is lost after a long time."""
        return (self.instant - self.lasting) * self._shape(F)[1] + self._of_the_past(F)

    def shape_energy(self, F: Expr) -> Expr:
        """See `SplitLaw`, after a long time: what no branch can lose."""
        if not self.law.linear:
            return self.lasting * self.law.shape_energy(F)
        relaxing = ufl.inner(self._shape(F)[1], infinitesimal_strain(F)) / 2
        return self.law.shape_energy(F) + (self.lasting - 1) * relaxing

    def energy(self, F: Expr) -> Expr:
        """Energy per reference volume after a long time [J/m^3]."""
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
