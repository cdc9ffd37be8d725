"""Metal plasticity at large strains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Literal, Self

import numpy as np
import ufl
from pydantic import model_validator
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.kinematics import deformation_from, displacement_gradient
from dolfin_elastic.model.materials.law import once
from dolfin_elastic.model.materials.laws.hencky import Logarithmic
from dolfin_elastic.model.materials.memory import Memory, Variable
from dolfin_elastic.model.materials.plasticity import (
    PLASTIC_STRAIN,
    RATE,
    Plastic,
    PlasticMemory,
    Return,
    dissipated,
    returned,
    scalars_at_end,
)
from dolfin_elastic.model.materials.stepped import SteppedSplitLaw

INVERSE = Variable("inverse_plastic_gradient", "tensor")
"""Fp^-1 - I, so that elastic strains below round-off of 1 are not lost."""
HALVINGS = 3
ORDER = 9
"""Of the exponential of a step's plastic strain: its error is below 1e-13 at a strain of one."""


class J2Logarithmic(Plastic, Logarithmic):
    """Metal plasticity at large strains: von Mises' yield condition on the Kirchhoff stress.

    psi = mu sum_i (ln l_i)^2 + lmbda/2 (ln J)^2 of the stretches l_i of Fe, F = Fe Fp: `hencky`.
    The elastic trial state of a step is F Fp^-1 with Fp of its start; the plastic strain grows
    along the deviator of the trial stress by an exponential, which keeps the volume, each step one
    of backward Euler in closed form.  For metal forming, necking and impact.  Quadratic elements
    do not lock at full plasticity; linear ones do.

    Source: G. Weber and L. Anand, Comput. Methods Appl. Mech. Eng. 79 (1990) 173; J. C. Simo,
    Comput. Methods Appl. Mech. Eng. 99 (1992) 61.
    """

    law: Literal["j2-logarithmic"] = "j2-logarithmic"
    example: ClassVar[Mapping[str, object]] = {
        "E": "210 GPa",
        "nu": 0.3,
        "yield_stress": "250 MPa",
        "hardening": {"saturation": "400 MPa", "rate": 15, "slope": "100 MPa"},
    }

    @model_validator(mode="after")
    def _isotropic_hardening(self) -> Self:
        if self.kinematic != 0.0:
            raise InputError(
                "a back stress at large strains is not computed",
                where="kinematic",
                expected='leave it out, or law = "j2" where strains are small',
            )
        return self

    @property
    def memory(self) -> Memory:
        """See `Law`."""
        # In plane stress a compiler would take longer than five minutes for its tangent.
        stepped = partial(SteppedLogarithmic, self)
        return LogarithmicMemory(self, INVERSE, stepped, plane_stress=False)


class LogarithmicMemory(PlasticMemory):
    """The same with Fp^-1 - I, whose plastic strain grows in the intermediate configuration."""

    def advanced(self, tensor: FloatArray, grown: FloatArray) -> FloatArray:
        """See `PlasticMemory`: Fp^-1 exp(-growth) - I."""
        one = np.eye(3)
        inverse = tensor.reshape(-1, 3, 3) + one
        B = grown.reshape(-1, 3, 3) / -(2**HALVINGS)
        power = np.broadcast_to(one, B.shape)
        for n in range(ORDER, 0, -1):
            power = one + B @ power / n
        for _ in range(HALVINGS):
            power = power @ power
        return np.asarray(inverse @ power - one).reshape(-1, 9)


@dataclass(frozen=True)
class SteppedLogarithmic(SteppedSplitLaw):
    """J2 plasticity at large strains over a step.

    Attributes:
        law: With constants of the material.
    """

    law: J2Logarithmic

    @once
    def _trial(self, F: Expr) -> tuple[Expr, Expr, Expr, Return]:
        """Fe of the trial state, its P and tau without pressure [Pa], and what yields."""
        H, G = displacement_gradient(F), self.past[INVERSE.name]
        Fe = deformation_from(H + G + H * G)
        P = self.law.shape_stress(Fe)
        tau = P * Fe.T
        return Fe, P, tau, returned(self.law, tau, self.past, self.step)

    def _left(self, F: Expr) -> Expr:
        """Share of the trial stress that is left, 1 - 3 mu growth/q."""
        return 1 - 3 * self.law.mu * self._trial(F)[3].share

    def strain(self, F: Expr) -> Expr:
        """The logarithmic strain of Fe, which Fe^T P of it gives."""
        Fe, P = self._trial(F)[:2]
        shape = self._left(F) * ufl.sym(Fe.T * P) / (2 * self.law.mu)
        return shape + self.volume_strain(F) / 3 * ufl.Identity(3)

    def shape_stress(self, F: Expr) -> Expr:
        """See `SteppedSplitLaw`: tau F^-T."""
        return self._left(F) * self._trial(F)[1] * (ufl.Identity(3) + self.past[INVERSE.name]).T

    def shape_energy(self, F: Expr) -> Expr:
        """See `SteppedSplitLaw`: tau:tau/(4 mu) of the deviator."""
        tau = self._trial(F)[2]
        return self._left(F) ** 2 * ufl.inner(tau, tau) / (4 * self.law.mu)

    def at_end(self, F: Expr) -> dict[str, Expr]:
        """See `OverStep`: Fp^-1 exp(-3/2 growth/q Fe^-1 tau Fe) of determinant 1."""
        Fe, P, _, found = self._trial(F)
        grown = 1.5 * found.share * (ufl.inv(Fe) * P * (Fe.T * Fe))
        before = ufl.Identity(3) + self.past[INVERSE.name]
        inverse = before * _exponential(-grown)
        result = {
            INVERSE.name: inverse / ufl.det(inverse) ** (1 / 3) - ufl.Identity(3),
            **scalars_at_end(self.law, found.growth, self.past, self.step),
        }
        if self.law.trapezoidal:
            result[RATE] = grown * self.step["per_dt"]
        return result

    def plastic_strain(self, F: Expr) -> Expr:
        """See `OverStep`."""
        return self.past[PLASTIC_STRAIN.name] + self._trial(F)[3].growth

    def lost(self, F: Expr) -> Expr:
        """See `OverStep`."""
        scalars = scalars_at_end(self.law, self._trial(F)[3].growth, self.past, self.step)
        return dissipated(self.law, scalars)


def _exponential(A: Expr) -> Expr:
    """exp A of a tensor, shape (3, 3): Taylor's series of A/2^n, squared n times."""
    B, one = A / 2**HALVINGS, ufl.Identity(3)
    result = one
    for n in range(ORDER, 0, -1):
        result = one + B * result / n
    for _ in range(HALVINGS):
        result = result * result
    return result
