"""Holzapfel-Gasser-Ogden artery wall."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import ClassVar, Literal

import ufl
from pydantic import Field
from ufl.core.expr import Expr

from dolfin_elastic.core.units import Number, Stress
from dolfin_elastic.model.kinematics import expm1
from dolfin_elastic.model.materials.isochoric import (
    Volumetric,
    excess_invariants,
    isochoric_strain,
    isochoric_stress,
    stress_of_invariants,
)
from dolfin_elastic.model.materials.spatial import Direction, direction


class HolzapfelGasserOgden(Volumetric):
    """Artery wall: a neo-Hookean matrix with one or two families of dispersed fibres.

    psi = mu/2 (I1 - 3) + k1/(2 k2) sum_i (exp(k2 e_i^2) - 1) + K/2 g(J)^2 with
    e_i = kappa I1 + (1 - 3 kappa) I4_i - 1, I1 and I4_i = f_i . C f_i of J^-2/3 C, summed over
    families with e_i > 0.  For arteries and other tissue with collagen.  The tangent
    jumps where a family goes slack, so Newton's method may need one or two more iterations.

    Source: T. C. Gasser, R. W. Ogden and G. A. Holzapfel, J. R. Soc. Interface 3 (2006) 15;
    without dispersion G. A. Holzapfel et al., J. Elasticity 61 (2000) 1.

    Attributes:
        mu: Shear modulus of the matrix [Pa].
        k1: Stiffness of the fibres [Pa].
        k2: Exponent of the stiffening of the fibres.
        kappa: Dispersion, from 0 (all fibres parallel) to 1/3 (isotropic).
        K: Bulk modulus [Pa].
        fibre: Direction of the first family in the undeformed body.
        fibre2: Direction of the second family; without it there is one family.
        slack: Whether fibres carry tension only; false: the same formula holds in compression.
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
        matrix = self._matrix(*excess_invariants(F))
        return matrix + self._fibres(isochoric_strain(F), expm1)

    def shape_stress(self, F: Expr) -> Expr:
        """Its derivative."""
        fibres = isochoric_stress(lambda E: self._fibres(E, lambda x: ufl.exp(x) - 1), F)
        return stress_of_invariants(self._matrix, F) + fibres

    def _matrix(self, first: Expr, second: Expr) -> Expr:
        return self.mu / 2 * first

    def _fibres(self, E: Expr, exponential: Callable[[Expr], Expr]) -> Expr:
        """Energy of all families.

        Args:
            E: Isochoric Green strain, shape (3, 3).
            exponential: e^x - 1.
        """
        families = [f for f in (self.fibre, self.fibre2) if f is not None]
        stored = sum(self._family(E, direction(f), exponential) for f in families)
        return self.k1 / (2 * self.k2) * stored

    def _family(self, E: Expr, f: Expr, exponential: Callable[[Expr], Expr]) -> Expr:
        e = 2 * (self.kappa * ufl.tr(E) + (1 - 3 * self.kappa) * ufl.inner(f, E * f))
        stored = exponential(self.k2 * e**2)
        return ufl.conditional(ufl.gt(e, 0), stored, 0) if self.slack else stored
