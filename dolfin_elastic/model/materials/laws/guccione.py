"""Guccione heart muscle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

import ufl
from pydantic import Field
from ufl.core.expr import Expr

from dolfin_elastic.core.units import Number, Stress
from dolfin_elastic.model.kinematics import expm1
from dolfin_elastic.model.materials.isochoric import Volumetric, isochoric_strain, isochoric_stress
from dolfin_elastic.model.materials.spatial import Direction, direction


class Guccione(Volumetric):
    """Passive heart muscle: exponential stiffening, stronger along the fibres than across.

    psi = C/2 (exp Q - 1) + K/2 g(J)^2, Q = bf Eff^2 + bt (Ess^2 + Enn^2 + 2 Esn^2)
    + 2 bfs (Efs^2 + Efn^2), E the Green strain of J^-1/3 F, f along the fibre, s and n across.
    The direction of the fibres usually follows the wall, so it may vary in space.

    Source: J. M. Guccione, A. D. McCulloch and L. K. Waldman, J. Biomech. Eng. 113 (1991) 42.

    Attributes:
        C: Stiffness [Pa].
        bf: Exponent along the fibre.
        bt: Exponent across the fibre.
        bfs: Exponent of shear between along and across.
        K: Bulk modulus [Pa].
        fibre: Direction of the fibre in the undeformed body.
    """

    law: Literal["guccione"] = "guccione"
    C: Stress = Field(gt=0)
    bf: Number = Field(gt=0)
    bt: Number = Field(gt=0)
    bfs: Number = Field(gt=0)
    K: Stress = Field(gt=0)
    fibre: Direction

    barrier: ClassVar[bool] = True
    limited: ClassVar[bool] = True
    directions: ClassVar[tuple[str, ...]] = ("fibre",)
    example: ClassVar[Mapping[str, object]] = {
        "C": "100 kPa",
        "bf": 8,
        "bt": 2,
        "bfs": 4,
        "K": "5 MPa",
        "fibre": [1, 0.5, 0.2],
    }

    def _Q(self, E: Expr) -> Expr:
        """By the products of the isochoric E and f that need no direction across."""
        f = direction(self.fibre)
        e = E * f
        along, drawn = ufl.inner(f, e) ** 2, ufl.inner(e, e)
        across = ufl.inner(E, E) - 2 * drawn + along
        return self.bf * along + self.bt * across + 2 * self.bfs * (drawn - along)

    def shape_energy(self, F: Expr) -> Expr:
        """C/2 (exp Q - 1)."""
        return self.C / 2 * expm1(self._Q(isochoric_strain(F)))

    def shape_stress(self, F: Expr) -> Expr:
        """Its derivative."""
        return isochoric_stress(lambda E: self.C / 2 * ufl.exp(self._Q(E)), F)
