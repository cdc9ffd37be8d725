"""Orthotropic linear elasticity."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, Literal

import ufl
from pydantic import Field
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import Scalar
from dolfin_elastic.core.units import Number, Stress
from dolfin_elastic.model.kinematics import infinitesimal_strain
from dolfin_elastic.model.materials.spatial import Direction, frame
from dolfin_elastic.model.materials.viscous import Viscous

SMALLEST_ANGLE = 1e-6
"""Sine of the angle below which two axes count as one."""


_NO_STIFFNESS = {"density", "expansion", "allowable", "viscosity", "axis1", "axis2"}
"""Constants whose change in space does not change the sign of a stiffness."""


class Orthotropic(Viscous):
    """Hooke's law with three planes of symmetry, for small strains.

    psi = (C11 e11^2 + C22 e22^2 + C33 e33^2)/2 + C12 e11 e22 + C13 e11 e33 + C23 e22 e33
    + 2 (G12 e12^2 + G13 e13^2 + G23 e23^2), e the infinitesimal strain in the material's axes.  The
    stiffness matrix C is the inverse of the compliance matrix 1/E1, -nu12/E1, ...  For wood,
    plywood, laminates, rolled and printed parts.  nu12 is the contraction along 2 under tension
    along 1: nu12/E1 = nu21/E2.

    Source: S. G. Lekhnitskii, Theory of Elasticity of an Anisotropic Body (1981).

    Attributes:
        E1: Young's modulus along axis 1 [Pa].
        E2: Young's modulus along axis 2 [Pa].
        E3: Young's modulus along axis 3 [Pa].
        nu12: Contraction along 2 under tension along 1.
        nu13: Contraction along 3 under tension along 1.
        nu23: Contraction along 3 under tension along 2.
        G12: Shear modulus between 1 and 2 [Pa].
        G13: Shear modulus between 1 and 3 [Pa].
        G23: Shear modulus between 2 and 3 [Pa].
        axis1: Direction of axis 1.
        axis2: Direction across axis 1, towards which axis 2 points; axis 3 is across both.
    """

    law: Literal["orthotropic"] = "orthotropic"
    E1: Stress = Field(gt=0)
    E2: Stress = Field(gt=0)
    E3: Stress = Field(gt=0)
    nu12: Number
    nu13: Number
    nu23: Number
    G12: Stress = Field(gt=0)
    G13: Stress = Field(gt=0)
    G23: Stress = Field(gt=0)
    axis1: Direction = Field(default=(1.0, 0.0, 0.0))
    axis2: Direction = Field(default=(0.0, 1.0, 0.0))

    linear: ClassVar[bool] = True
    frame_indifferent: ClassVar[bool] = False
    directions: ClassVar[tuple[str, ...]] = ("axis1", "axis2")
    example: ClassVar[Mapping[str, object]] = {
        "E1": "1 MPa",
        "E2": "600 kPa",
        "E3": "300 kPa",
        "nu12": 0.3,
        "nu13": 0.25,
        "nu23": 0.2,
        "G12": "250 kPa",
        "G13": "200 kPa",
        "G23": "150 kPa",
        "axis1": [1, 1, 0],
        "axis2": [0, 1, 1],
    }

    @property
    def surely_stiff(self) -> bool:
        """See `Law`: constants that vary in space are not checked against each other."""
        varies = self.spatial_constants().keys() - _NO_STIFFNESS
        return type(self) is Orthotropic and not varies

    def model_post_init(self, context: object) -> None:
        """Checks that the solid is stable and that its axes differ."""
        if any(name not in self.directions for name in self.spatial_constants()):
            return
        for a, b in ("12", "13", "23"):
            nu, Ea, Eb = (getattr(self, name) for name in (f"nu{a}{b}", f"E{a}", f"E{b}"))
            if not nu**2 < Ea / Eb:
                raise InputError(
                    f"{nu:g} is not a possible Poisson's ratio",
                    where=f"nu{a}{b}",
                    expected=f"|nu{a}{b}| must lie below sqrt(E{a}/E{b}) = {math.sqrt(Ea / Eb):g}",
                )
        if not self._determinant() > 0:
            raise InputError(
                "no stable elastic solid has these Poisson's ratios together",
                where="nu12, nu13, nu23",
                expected="the compliance must be positive definite: make them smaller",
            )
        self._check_axes()

    def _check_axes(self) -> None:
        if self.spatial_constants():
            return
        a, b = self.axis1, self.axis2
        cosine = sum(x * y for x, y in zip(a, b, strict=True)) / math.hypot(*a) / math.hypot(*b)
        if 1 - cosine**2 < SMALLEST_ANGLE**2:
            raise InputError(
                "axis1 and axis2 are parallel",
                where="axis2",
                expected="axis2 must point to one side of axis1",
            )

    def _determinant(self) -> Scalar:
        """Determinant of the compliances of tension, times E1 E2 E3."""
        r12, r13, r23 = self.E2 / self.E1, self.E3 / self.E1, self.E3 / self.E2
        return (
            1
            - self.nu12**2 * r12
            - self.nu13**2 * r13
            - self.nu23**2 * r23
            - 2 * self.nu12 * self.nu23 * self.nu13 * r13
        )

    def _stiffness(self) -> list[list[Scalar]]:
        r12, r13, r23 = self.E2 / self.E1, self.E3 / self.E1, self.E3 / self.E2
        nu12, nu13, nu23 = self.nu12, self.nu13, self.nu23
        D = self._determinant()
        C11, C22, C33 = (
            self.E1 * (1 - nu23**2 * r23) / D,
            self.E2 * (1 - nu13**2 * r13) / D,
            self.E3 * (1 - nu12**2 * r12) / D,
        )
        C12 = self.E2 * (nu12 + nu13 * nu23 * r23) / D
        C13 = self.E3 * (nu13 + nu12 * nu23) / D
        C23 = self.E3 * (nu23 + nu12 * nu13 * r12) / D
        return [[C11, C12, C13], [C12, C22, C23], [C13, C23, C33]]

    def energy(self, F: Expr) -> Expr:
        """See the class."""
        axes = frame(self.axis1, self.axis2)
        strain = infinitesimal_strain(F)
        e = [[ufl.inner(a, strain * b) for b in axes] for a in axes]
        C = self._stiffness()
        tension = sum(C[i][j] * e[i][i] * e[j][j] for i in range(3) for j in range(3)) / 2
        shear = self.G12 * e[0][1] ** 2 + self.G13 * e[0][2] ** 2 + self.G23 * e[1][2] ** 2
        return tension + 2 * shear
