"""Metal plasticity at small strains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Literal

import ufl
from ufl.core.expr import Expr

from dolfin_elastic.model.kinematics import infinitesimal_strain
from dolfin_elastic.model.materials.law import once
from dolfin_elastic.model.materials.memory import Memory, Variable
from dolfin_elastic.model.materials.plasticity import (
    PLASTIC_STRAIN,
    RATE,
    Plastic,
    PlasticMemory,
    dissipated,
    returned,
    scalars_at_end,
)
from dolfin_elastic.model.materials.stepped import SteppedSplitLaw

TENSOR = Variable("plastic_strain_tensor", "symmetric")


class J2(Plastic):
    """Metal plasticity at small strains: von Mises' yield condition, associated flow.

    psi = mu dev e:dev e + K/2 (tr e)^2 + kinematic/3 ep:ep, e = eps - ep the elastic strain.
    Hooke's law up to the yield stress.  Beyond it the plastic strain grows along the deviator of
    the stress, each step one of backward Euler in closed form.  For strains and rotations up to a
    few per cent.  Quadratic elements do not lock at full plasticity; linear ones do.

    Source: Simo & Hughes, Computational Inelasticity (1998), box 3.2.
    """

    law: Literal["j2"] = "j2"
    linear: ClassVar[bool] = True
    frame_indifferent: ClassVar[bool] = False
    follows_large: ClassVar[str] = "j2-logarithmic follows large ones"
    example: ClassVar[Mapping[str, object]] = {
        "E": "210 GPa",
        "nu": 0.3,
        "yield_stress": "250 MPa",
        "hardening": "1 GPa",
    }

    @property
    def memory(self) -> Memory:
        """See `Law`."""
        return PlasticMemory(self, TENSOR, partial(SteppedJ2, self))

    def shape_energy(self, F: Expr) -> Expr:
        """mu dev eps:dev eps, before anything has yielded."""
        eps = ufl.dev(infinitesimal_strain(F))
        return self.mu * ufl.inner(eps, eps)

    def volume_strain(self, F: Expr) -> Expr:
        """tr eps."""
        return ufl.tr(infinitesimal_strain(F))


@dataclass(frozen=True)
class SteppedJ2(SteppedSplitLaw):
    """J2 plasticity at small strains over a step.

    Attributes:
        law: With constants of the material.
    """

    law: J2

    @once
    def _return(self, F: Expr) -> tuple[Expr, Expr]:
        """Growth of the equivalent plastic strain, and the plastic strain at the end."""
        before, law = self.past[TENSOR.name], self.law
        elastic = ufl.dev(infinitesimal_strain(F)) - before
        trial = 2 * law.mu * elastic - 2 / 3 * law.back_slope * before
        found = returned(law, trial, self.past, self.step)
        return found.growth, before + 1.5 * found.share * trial

    def strain(self, F: Expr) -> Expr:
        """The elastic strain."""
        return infinitesimal_strain(F) - self._return(F)[1]

    def shape_stress(self, F: Expr) -> Expr:
        """See `SteppedSplitLaw`: 2 mu of the elastic deviator."""
        return 2 * self.law.mu * (ufl.dev(infinitesimal_strain(F)) - self._return(F)[1])

    def shape_energy(self, F: Expr) -> Expr:
        """See `SteppedSplitLaw`: of the elastic strain, and of the back stress."""
        plastic = self._return(F)[1]
        elastic = ufl.dev(infinitesimal_strain(F)) - plastic
        back = self.law.back_slope / 3 * ufl.inner(plastic, plastic)
        return self.law.mu * ufl.inner(elastic, elastic) + back

    def at_end(self, F: Expr) -> dict[str, Expr]:
        """See `OverStep`."""
        growth, tensor = self._return(F)
        result = {TENSOR.name: tensor, **scalars_at_end(self.law, growth, self.past, self.step)}
        if self.law.trapezoidal:
            result[RATE] = (tensor - self.past[TENSOR.name]) * self.step["per_dt"]
        return result

    def plastic_strain(self, F: Expr) -> Expr:
        """See `OverStep`."""
        return self.past[PLASTIC_STRAIN.name] + self._return(F)[0]

    def lost(self, F: Expr) -> Expr:
        """See `OverStep`."""
        return dissipated(self.law, self.at_end(F))
