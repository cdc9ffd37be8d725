"""Metal plasticity at large strains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Literal

import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.kinematics import deformation_from, displacement_gradient
from dolfin_elastic.model.materials.law import once
from dolfin_elastic.model.materials.laws.hencky import Logarithmic
from dolfin_elastic.model.materials.memory import SIX, Memory, Values, Variable
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
BACK = Variable("back_strain", "symmetric")
"""Of the back stress, 2/3 kinematic times it, in the intermediate configuration."""
_GAUSS = np.polynomial.legendre.leggauss(4)
NODES, WEIGHTS = [(float(x) + 1) / 2 for x in _GAUSS[0]], [float(w) / 2 for w in _GAUSS[1]]
"""Of the rational logarithm: its error is below 1e-11 of an elastic trial stretch of 1.1.

Source: N. J. Higham, Functions of Matrices (2008), section 11.4.
"""
HALVINGS = 3
ORDER = 9
"""Of the exponential of a step's plastic strain: its error is below 1e-13 at a strain of one."""


class J2Logarithmic(Plastic, Logarithmic):
    """Metal plasticity at large strains: von Mises' yield condition on the Kirchhoff stress.

    psi = mu sum_i (ln l_i)^2 + lmbda/2 (ln J)^2 of the stretches l_i of Fe, F = Fe Fp: `hencky`.
    The elastic trial state of a step is F Fp^-1 with Fp of its start; the plastic strain grows
    along the deviator of the trial stress by an exponential, which keeps the volume, each step one
    of backward Euler in closed form.  With `kinematic` the yield condition is one on Mandel's
    stress less a back stress of the intermediate configuration, kinematic/3 a:a its energy, a the
    sum of all growths of the plastic strain there: a rotated body has the same.  For metal forming,
    necking and impact.  Quadratic elements do not lock at full plasticity; linear ones do.

    Source: G. Weber and L. Anand, Comput. Methods Appl. Mech. Eng. 79 (1990) 173; J. C. Simo,
    Comput. Methods Appl. Mech. Eng. 99 (1992) 61; A. L. Eterovic and K.-J. Bathe, Int. J. Numer.
    Methods Eng. 30 (1990) 1099 (back stress).
    """

    law: Literal["j2-logarithmic"] = "j2-logarithmic"
    example: ClassVar[Mapping[str, object]] = {
        "E": "210 GPa",
        "nu": 0.3,
        "yield_stress": "250 MPa",
        "hardening": {"saturation": "400 MPa", "rate": 15, "slope": "100 MPa"},
    }

    @property
    def memory(self) -> Memory:
        """See `Law`."""
        return LogarithmicMemory(self)

    @property
    def turns_around(self) -> bool:
        """It has a back stress."""
        return self.kinematic is not None


class LogarithmicMemory(PlasticMemory):
    """The same with Fp^-1 - I, whose plastic strain grows in the intermediate configuration."""

    def __init__(self, law: J2Logarithmic) -> None:
        # In plane stress a compiler would take longer than five minutes for its tangent.
        super().__init__(law, INVERSE, partial(SteppedLogarithmic, law), plane_stress=False)
        if law.turns_around:
            self._seen = (*self._seen, BACK)
            self.variables = (*self.variables, BACK)

    def fold(self, values: Values, dt: float) -> Values:
        """See `PlasticMemory`: the back stress grows with the plastic strain."""
        result = dict(super().fold(values, dt))
        if BACK in self._seen and RATE in values:
            rows = [3 * i + j for i, j in SIX]
            result[BACK.name] = values[BACK.name] + dt / 2 * values[RATE][:, rows]
        return result

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
        """Fe of the trial state, its P without pressure and its stress, and what yields.

        The stress [Pa] is tau, or with a back stress b Mandel's Fe^T tau Fe^-T less b.
        """
        H, G = displacement_gradient(F), self.past[INVERSE.name]
        Fe = deformation_from(H + G + H * G)
        P = self.law.shape_stress(Fe)
        stress = ufl.sym(Fe.T * P) - self._back if self.law.turns_around else P * Fe.T
        return Fe, P, stress, returned(self.law, stress, self.past, self.step)

    @property
    def _back(self) -> Expr:
        """Back stress of the start [Pa]."""
        return 2 / 3 * self.law.back_slope * self.past[BACK.name]

    def _lost(self, F: Expr) -> Expr:
        """Share of the trial stress, measured from the back stress, that flow takes away."""
        return 3 * self.law.mu * self._trial(F)[3].share

    def _mandel(self, F: Expr) -> Expr:
        """Mandel's stress at the end without pressure [Pa]."""
        Fe, P, stress, _ = self._trial(F)
        trial = ufl.sym(Fe.T * P)
        return trial - self._lost(F) * (stress if self.law.turns_around else trial)

    def strain(self, F: Expr) -> Expr:
        """The logarithmic strain of Fe, which Fe^T P of it gives."""
        return self._mandel(F) / (2 * self.law.mu) + self.volume_strain(F) / 3 * ufl.Identity(3)

    def shape_stress(self, F: Expr) -> Expr:
        """See `SteppedSplitLaw`: tau F^-T.

        What a step adds to the energy is a function of the logarithmic strain E of the trial state,
        and its derivative there Mandel's stress: b:E has the derivative Fe sum w A^-1 b A^-1, with
        A = I + t (Fe^T Fe - I) at the nodes t of the rational logarithm.
        """
        Fe, P = self._trial(F)[:2]
        result = (1 - self._lost(F)) * P
        if self.law.turns_around:
            H, one = displacement_gradient(Fe), ufl.Identity(3)
            C = H + H.T + H.T * H
            along = ufl.zero(3, 3)
            for node, weight in zip(NODES, WEIGHTS, strict=True):
                inverse = ufl.inv(one + node * C)
                along += weight * inverse * self._back * inverse
            result += self._lost(F) * Fe * along
        return result * (ufl.Identity(3) + self.past[INVERSE.name]).T

    def shape_energy(self, F: Expr) -> Expr:
        """See `SteppedSplitLaw`: tau:tau/(4 mu) of the deviator, and of the back stress."""
        if not self.law.turns_around:
            tau = self._trial(F)[2]
            return (1 - self._lost(F)) ** 2 * ufl.inner(tau, tau) / (4 * self.law.mu)
        stress, back = self._mandel(F), self.past[BACK.name] + self._grown(F)
        elastic = ufl.inner(stress, stress) / (4 * self.law.mu)
        return elastic + self.law.back_slope / 3 * ufl.inner(back, back)

    def _grown(self, F: Expr) -> Expr:
        """Growth of the plastic strain in the intermediate configuration, shape (3, 3)."""
        Fe, P, stress, found = self._trial(F)
        if not self.law.turns_around:
            stress = ufl.inv(Fe) * P * (Fe.T * Fe)
        return 1.5 * found.share * stress

    def at_end(self, F: Expr) -> dict[str, Expr]:
        """See `OverStep`: Fp^-1 exp(-growth) of determinant 1."""
        grown = self._grown(F)
        before = ufl.Identity(3) + self.past[INVERSE.name]
        inverse = before * _exponential(-grown)
        growth = self._trial(F)[3].growth
        result = {
            INVERSE.name: inverse / ufl.det(inverse) ** (1 / 3) - ufl.Identity(3),
            **scalars_at_end(self.law, growth, self.past, self.step),
        }
        if self.law.turns_around:
            result[BACK.name] = self.past[BACK.name] + grown
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
