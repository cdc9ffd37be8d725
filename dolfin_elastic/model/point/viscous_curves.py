"""Relaxation modulus over time, storage and loss modulus over frequency of a viscous law.

All are those of small strains, over the modulus of the law's constants: with the ratios r, the
times tau and the lasting part a of `materials.law.Branched`

    G(t) = a + sum r exp(-t/tau),
    G' = a + sum r (w tau)^2/(1 + (w tau)^2),       G'' = sum r w tau/(1 + (w tau)^2).

Source: J. D. Ferry, Viscoelastic Properties of Polymers (1980), chapter 3, (11), (28) and (29).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.model.materials.law import Law

_DECADES = 2
"""Of time before the shortest relaxation time, and after the longest."""
_POINTS = 20
"""In each decade."""


@dataclass(frozen=True)
class ViscousCurves:
    """How a law relaxes.

    Attributes:
        law: With `viscous`.
        t: Times since a sudden strain [s], shape (n,).
        omega: Angular frequencies [rad/s], shape (n,).
        mu: Shear modulus of the law's constants at small strains [Pa]; None where there is no one.
    """

    law: Law
    t: FloatArray
    omega: FloatArray
    mu: float | None

    @cached_property
    def relaxation(self) -> FloatArray:
        """G(t) over the modulus of the constants, shape (n,)."""
        ratios, times = self.law.series
        return self.law.lasting + np.exp(-self.t[:, None] / times) @ ratios

    @cached_property
    def storage(self) -> FloatArray:
        """G' over the modulus of the constants, shape (n,)."""
        ratios, times = self.law.series
        x = (self.omega[:, None] * times) ** 2
        return self.law.lasting + (x / (1 + x)) @ ratios

    @cached_property
    def loss(self) -> FloatArray:
        """G'' over the modulus of the constants, shape (n,)."""
        ratios, times = self.law.series
        x = self.omega[:, None] * times
        return (x / (1 + x**2)) @ ratios

    @property
    def loss_factor(self) -> FloatArray:
        """G''/G', shape (n,)."""
        return self.loss / self.storage

    @property
    def most_damped(self) -> tuple[float, float]:
        """Largest loss factor, and the angular frequency of it [rad/s]."""
        n = int(np.argmax(self.loss_factor))
        return float(self.loss_factor[n]), float(self.omega[n])


def viscous_curves(law: Law) -> ViscousCurves | None:
    """The curves of a law; None where nothing relaxes."""
    if not law.viscous:
        return None
    times = law.series[1]
    low, high = np.log10(times.min()) - _DECADES, np.log10(times.max()) + _DECADES
    t = np.logspace(low, high, int(np.ceil(_POINTS * (high - low))) + 1)
    known = law.small_strain()
    return ViscousCurves(law, t, 1 / t[::-1], None if known is None else known.mu)
