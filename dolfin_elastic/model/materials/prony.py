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

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import ufl
from pydantic import Field, field_validator
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.schema import Record, WhenGiven
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import Number, Time
from dolfin_elastic.model.kinematics import cofactor, infinitesimal_strain
from dolfin_elastic.model.materials.law import SplitLaw, once
from dolfin_elastic.model.materials.memory import Memory, Values, Variable
from dolfin_elastic.model.materials.stepped import SteppedLaw, SteppedSplitLaw


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
    def memory(self) -> Memory | None:
        """See `Law`."""
        return Prony(self) if self.prony else None

    @property
    def lasting(self) -> float:
        """Share of the shear stiffness that stays for ever, 1 - sum g."""
        return 1.0 - sum(term.g for term in self.prony)


@dataclass(frozen=True)
class Relaxed(SteppedSplitLaw):
    """A law over a time step whose stress relaxes.

    `past` is H of the module [Pa]; in `step`, "instant" is the factor of the deviatoric stress,
    1 - sum g (1 - f), and "lasting" the same after a long time, 1 - sum g.
    """

    @once
    def _shape(self, F: Expr) -> tuple[Expr, Expr]:
        """The law's stress without volumetric part, and its deviatoric part [Pa]."""
        P = self.law.shape_stress(F)
        return P, ufl.dev(P) if self.law.linear else P

    @once
    def _of_the_past(self, F: Expr) -> Expr:
        """Stress of H [Pa]: the derivative of H : J^-2/3 C/2, of linear laws of H : dev eps."""
        H = self.past["H"]
        if self.law.linear:
            return ufl.dev(H)
        FH, J = F * H, ufl.det(F)
        return J ** (-2 / 3) * (FH - ufl.inner(FH, F) / (3 * J) * cofactor(F))

    def shape_stress(self, F: Expr) -> Expr:
        """See `SteppedLaw`."""
        P, relaxing = self._shape(F)
        return P + (self.step["instant"] - 1) * relaxing + self._of_the_past(F)

    def branch_stress(self, F: Expr) -> Expr:
        """See `SteppedLaw`: the stress of all branches, which is lost after a long time."""
        share = self.step["instant"] - self.step["lasting"]
        return share * self._shape(F)[1] + self._of_the_past(F)

    def shape_energy(self, F: Expr) -> Expr:
        """See `SteppedLaw`, after a long time: what no branch can lose."""
        lasting = self.step["lasting"]
        if not self.law.linear:
            return lasting * self.law.shape_energy(F)
        relaxing = ufl.inner(self._shape(F)[1], infinitesimal_strain(F)) / 2
        return self.law.shape_energy(F) + (lasting - 1) * relaxing

    def at_end(self, F: Expr) -> dict[str, Expr]:
        """S of the module."""
        P = self.law.shape_stress(F)
        S = ufl.dev(P) if self.law.linear else ufl.det(F) ** (-1 / 3) * cofactor(F).T * P
        return {"S": S}


class Prony(Memory):
    """What a Prony series remembers: S and one h for each term [Pa], see the module.

    All terms fold into one tensor H, the same for the whole step.
    """

    seen = (Variable("H", "symmetric"),)
    found = (Variable("S", "symmetric"),)

    def __init__(self, law: Relaxing) -> None:
        self._law = law
        self._g = np.array([term.g for term in law.prony])
        self._tau = np.array([term.tau for term in law.prony])
        self._names = [f"h{i + 1}" for i in range(len(self._g))]
        self.variables = tuple(Variable(name, "symmetric") for name in ("S", *self._names))

    def _weights(self, dt: float) -> tuple[FloatArray, FloatArray]:
        """e and f of each term."""
        x = dt / self._tau
        return np.exp(-x), -np.expm1(-x) / x if dt > 0.0 else np.ones_like(x)

    def over_step(self, past: Mapping[str, Expr], step: Mapping[str, Expr]) -> SteppedLaw:
        """See `Memory`."""
        return Relaxed(self._law, past, step)

    def step(self, dt: float, *, passes: bool) -> dict[str, float]:
        """See `Memory`."""
        f = self._weights(dt)[1]
        return {
            "instant": 1.0 - float(self._g @ (1.0 - f)),
            "lasting": self._law.lasting if passes else 1.0,
        }

    def fold(self, values: Values, dt: float) -> Values:
        """See `Memory`: H."""
        e, f = self._weights(dt)
        H = -float(self._g @ f) * values["S"]
        for weight, name in zip(self._g * e, self._names, strict=True):
            H += weight * values[name]
        return {"H": H}

    def follow(self, values: Values, found: Values, dt: float) -> Values:
        """See `Memory`."""
        e, f = self._weights(dt)
        change = found["S"] - values["S"]
        branches = {n: e[i] * values[n] + f[i] * change for i, n in enumerate(self._names)}
        return {"S": found["S"], **branches}
