"""Holzapfel-Gasser-Ogden artery wall."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

import ufl
from pydantic import Field
from ufl.core.expr import Expr

from dolfin_elastic.core.units import Number, Stress
from dolfin_elastic.model.materials.fibres import direction
from dolfin_elastic.model.materials.isochoric import Volumetric, isochoric_part, isochoric_stress
from dolfin_elastic.model.materials.spatial import Direction


class HolzapfelGasserOgden(Volumetric):
    """Artery wall: a neo-Hookean matrix with one or two families of dispersed fibres.

    psi = mu/2 (I1 - 3) + k1/(2 k2) sum_i (exp(k2 e_i^2) - 1) + K/2 g(J)^2 with
    e_i = kappa I1 + (1 - 3 kappa) I4_i - 1, I1 and I4_i = f_i . C f_i of J^-2/3 C, summed over
    families with e_i > 0.  For arteries and other tissue with collagen.  Where a family goes slack
    the tangent jumps, which may cost Newton's method an iteration or two.

    Source: T. C. Gasser, R. W. Ogden and G. A. Holzapfel, J. R. Soc. Interface 3 (2006) 15;
    without dispersion G. A. Holzapfel et al., J. Elasticity 61 (2000) 1.

    Attributes:
        mu: Shear modulus of the matrix [Pa].
        k1: Stiffness of the fibres [Pa].
        k2: How fast the fibres stiffen.
        kappa: Dispersion, from 0 (all parallel) to 1/3 (no direction at all).
        K: Bulk modulus [Pa].
        fibre: Direction of the first family in the undeformed body.
        fibre2: Direction of the second family; without it there is one.
        slack: Whether fibres bear no compression; false: they do, as smooth as the exponential.
    """

    law: Literal["holzapfel-gasser-ogden"] = "holzapfel-gasser-ogden"
    mu: Stress = Field(gt=0)
    k1: Stress = Field(gt=0)
    k2: Number = Field(gt=0)
    kappa: Number = Field(default=0.0, ge=0, le=1 / 3)
    K: Stress = Field(gt=0)
    fibre: Direction
    fibre2: Direction | None = None
    slack: bool = True

    barrier: ClassVar[bool] = True
    directions: ClassVar[tuple[str, ...]] = ("fibre", "fibre2")
    example: ClassVar[Mapping[str, object]] = {
        "mu": "300 kPa",
        "k1": "200 kPa",
        "k2": 0.8,
        "kappa": 0.1,
        "K": "5 MPa",
        "fibre": [0.8, 0.6, 0],
        "fibre2": [0.8, -0.6, 0],
    }

    def shape_energy(self, F: Expr) -> Expr:
        """Matrix and fibres."""
        return self._psi(isochoric_part(F))

    def shape_stress(self, F: Expr) -> Expr:
        """Its derivative."""
        return isochoric_stress(self._psi, F)

    def _psi(self, C: Expr) -> Expr:
        I1 = ufl.tr(C)
        families = [f for f in (self.fibre, self.fibre2) if f is not None]
        fibres = sum(self._family(C, I1, direction(f)) for f in families)
        return self.mu / 2 * (I1 - 3) + self.k1 / (2 * self.k2) * fibres

    def _family(self, C: Expr, I1: Expr, f: Expr) -> Expr:
        e = self.kappa * I1 + (1 - 3 * self.kappa) * ufl.inner(f, C * f) - 1
        stored = ufl.exp(self.k2 * e**2) - 1
        return ufl.conditional(ufl.gt(e, 0), stored, 0) if self.slack else stored
