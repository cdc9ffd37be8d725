"""Bases of laws with a volumetric part of its own: psi = psi_iso(J^-1/3 F) + K/2 g(J)^2."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

import ufl
from pydantic import Field
from ufl.core.expr import Expr

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.types import Scalar
from dolfin_elastic.core.units import Number, Stress
from dolfin_elastic.model.kinematics import (
    cofactor,
    green_strain,
    less_cofactor,
    log1p,
    volume_change,
)
from dolfin_elastic.model.materials import moduli
from dolfin_elastic.model.materials.law import Moduli, SplitLaw, placeholder
from dolfin_elastic.model.materials.spatial import Range
from dolfin_elastic.model.materials.viscous import Viscous

NEAR = 0.15
"""|J - 1|/(J + 1) below which a series stands for the logarithm, which would cancel."""
TERMS = 9


def simo_taylor(J: Expr, j: Expr) -> Expr:
    """g = sign(j) sqrt((J^2 - 1 - 2 ln J)/2), so that K/2 g^2 = K/4 (J^2 - 1 - 2 ln J).

    With t = (J - 1)/(J + 1) it is t times a root that is smooth at J = 1, see `_root`.

    Args:
        J: Current over reference volume.
        j: J - 1.

    Source: J. C. Simo and R. L. Taylor, Comput. Methods Appl. Mech. Eng. 35 (1982) 107.
    """
    return j / (J + 1) * _root(J, j)


def _root(J: Expr, j: Expr) -> Expr:
    """The root g/t of `simo_taylor`.

    J = (1 + t)/(1 - t) and ln J = 2 artanh t, so it is sqrt(2 (2 - t)/(1 - t)^2 - 2 t s) with
    s = (artanh t - t)/t^3 = 1/3 + t^2/5 + t^4/7 + ...

    Arguments: see `simo_taylor`.
    """
    t = j / (J + 1)
    series: Scalar = 0.0
    for n in reversed(range(TERMS)):
        series = series * t**2 + 1 / (2 * n + 3)
    near = ufl.lt(abs(t), NEAR)
    # UFL evaluates both branches: the one that is not chosen must not divide by zero.
    away = ufl.conditional(near, 1.0, t)
    s = ufl.conditional(near, series, (ufl.ln(J) / (2 * away) - 1) / away**2)
    return ufl.sqrt(2 * (2 - t) / (1 - t) ** 2 - 2 * t * s)


@dataclass(frozen=True)
class VolumeStrain:
    """A measure g(J) of the change of volume, with g = 0 and g' = 1 at J = 1.

    All are functions of J and of j = J - 1, of which one is rounded where the other is small.
    Derivatives are written out: those that UFL makes of g and its conditions are many times longer.

    Attributes:
        strain: g.
        slope: g'.
        stress: g g', the derivative of g^2/2; like g it is NaN for J < 0 if ln J is in it.
    """

    strain: Callable[[Expr, Expr], Expr]
    slope: Callable[[Expr, Expr], Expr | float]
    stress: Callable[[Expr, Expr], Expr]


# Of "simo-taylor" g g' = (J - 1/J)/2, and g' is that over g.  sqrt(J)^2 refuses J < 0.
VOLUME_STRAINS: dict[str, VolumeStrain] = {
    "simo-taylor": VolumeStrain(
        simo_taylor,
        lambda J, j: (J + 1) ** 2 / (2 * J * _root(J, j)),
        lambda J, j: j * (J + 1) / (2 * ufl.sqrt(J) ** 2),
    ),
    "quadratic": VolumeStrain(lambda J, j: j, lambda J, j: 1.0, lambda J, j: j),
    "log": VolumeStrain(lambda J, j: log1p(j, J), lambda J, j: 1 / J, lambda J, j: log1p(j, J) / J),
}
"""Name to measure."""


def _volume(F: Expr) -> tuple[Expr, Expr]:
    """J and J - 1."""
    return ufl.det(F), volume_change(F)


class Volumetric(Viscous, SplitLaw):
    """A law whose energy of volume changes, K/2 g(J)^2, can be chosen.

    Attributes:
        volumetric: Energy of volume changes: "simo-taylor", K/4 (J^2 - 1 - 2 ln J);
            "quadratic", K/2 (J - 1)^2, soft in strong compression; "log", K/2 (ln J)^2, soft above
            J = e.  At nu = 0.5 the key has no effect: the constraint is J = 1.
    """

    volumetric: Literal["simo-taylor", "quadratic", "log"] = "simo-taylor"

    strain_of_volume: ClassVar[bool] = True

    @property
    def isochoric_shape(self) -> bool:
        """See `Law`."""
        return True

    @property
    def curved_strain(self) -> bool:
        """See `SplitLaw`."""
        return self.volumetric != "quadratic"

    def volume_strain(self, F: Expr) -> Expr:
        """See `VOLUME_STRAINS`."""
        return VOLUME_STRAINS[self.volumetric].strain(*_volume(F))

    def volume_gradient(self, F: Expr) -> Expr:
        """g'(J) cof F."""
        return VOLUME_STRAINS[self.volumetric].slope(*_volume(F)) * cofactor(F)

    def volume_stress(self, F: Expr) -> Expr:
        """g g' cof F."""
        return VOLUME_STRAINS[self.volumetric].stress(*_volume(F)) * cofactor(F)


class Isochoric(Volumetric):
    """An isotropic law with constants of its own for the shape, and one for the volume: K or nu.

    Attributes:
        K: Bulk modulus [Pa]; or give nu.
        nu: Poisson's ratio at small strains; or give K.
    """

    K: Stress = Field(default_factory=placeholder, gt=0)
    nu: Number = Field(default_factory=placeholder)

    @abstractmethod
    def shear(self) -> float:
        """Shear modulus at small strains [Pa], from the constants of the shape."""

    def model_post_init(self, context: object) -> None:
        """Fills in whichever of K and nu was not given."""
        given = {name: getattr(self, name) for name in ("K", "nu") if name in self.model_fields_set}
        if len(given) != 1:
            raise InputError(
                "K and nu given together" if given else "neither K nor nu is given",
                expected="one of them beside the law's own constants: nu = 0.5 is incompressible, "
                "as usual for rubber and soft tissue",
            )
        if self.spatial_constants():
            return
        mu = self.shear()
        if not mu > 0:
            raise InputError(
                f"the shear modulus at small strains comes out as {mu:g}",
                expected="the constants must give a positive one",
            )
        full = moduli.complete(mu=mu, **given)
        self.__dict__.update(K=full.K, nu=full.nu)

    def complete(self) -> None:
        """See `Law.complete`."""
        full = self.small_strain()
        self.__dict__.update(K=full.K, nu=full.nu)

    @classmethod
    def ranges(cls) -> dict[str, Range]:
        """See `Law.ranges`."""
        return {**super().ranges(), "K": Range(low=0.0), "nu": Range(low=-1.0, high=0.5)}

    def small_strain(self) -> Moduli:
        """See `Law.small_strain`."""
        volume = {"K": self.K} if "K" in self.model_fields_set else {"nu": self.nu}
        return Moduli(**moduli.symbolic({"mu": self.shear(), **volume}))


def isochoric_strain(F: Expr) -> Expr:
    """Green strain of the isochoric part J^-1/3 F: (J^-2/3 C - I)/2.

    With r = J^1/3 it is (E - (r^2 - 1)/2 I)/r^2, and r^2 - 1 = (J - 1)(1 + r)/(1 + r + r^2).

    Source: P. J. Flory, Trans. Faraday Soc. 57 (1961) 829.
    """
    r = ufl.det(F) ** (1 / 3)
    swelling = volume_change(F) * (1 + r) / (2 * (1 + r + r * r))
    return (green_strain(F) - swelling * ufl.Identity(3)) / (r * r)


def isochoric_stress(psi: Callable[[Expr], Expr], F: Expr) -> Expr:
    """First Piola-Kirchhoff stress of an energy of the isochoric Green strain.

    P = J^-2/3 (F S - (S:C)/3 F^-T) with S = dpsi/dE, for anisotropic energies whose S is 0 at rest:
    a tangent made from this compiles several times faster than one from derivatives through F.

    Source: G. A. Holzapfel, Nonlinear Solid Mechanics (2000), section 6.4.

    Args:
        psi: Energy [J/m^3] as a function of the isochoric Green strain, shape (3, 3).
        F: Deformation gradient, shape (3, 3).
    """
    E = ufl.variable(isochoric_strain(F))
    S, J = ufl.sym(ufl.diff(psi(E), E)), ufl.det(F)
    FS, r = F * S, J ** (1 / 3)
    return (FS - ufl.inner(FS, F) / (3 * J) * cofactor(F)) / (r * r)


def _strains_of_shape(F: Expr) -> tuple[Expr, Expr]:
    """m = I1/3 and A = C - m I, twice the deviator of E: C = m I + A."""
    return ufl.inner(F, F) / 3, 2 * ufl.dev(green_strain(F))


def excess_invariants(F: Expr) -> tuple[Expr, Expr]:
    """I1 J^-2/3 - 3 and I2 J^-4/3 - 3, both of second order in the strain.

    From the characteristic polynomial of C/m = I + A/m, with a = A:A/(2 m^2):
    det C/m^3 = 1 - y, y = a - det A/m^3, and I2/m^2 = 3 - a.  With r = (1 - y)^1/3 the two are
    3/r - 3 and (3 - a)/r^2 - 3, where 1 - r = y/(1 + r + r^2).

    Source: Bonet & Wood (2008), (6.51) and (6.16).
    """
    m, A = _strains_of_shape(F)
    a = ufl.inner(A, A) / (2 * m**2)
    y, r = a - ufl.det(A) / m**3, ufl.det(F) ** (2 / 3) / m
    rest = y / (1 + r + r**2)  # 1 - r
    return 3 * rest / r, (3 * rest * (1 + r) - a) / r**2


def stress_of_invariants(psi: Callable[[Expr, Expr], Expr], F: Expr) -> Expr:
    """First Piola-Kirchhoff stress of an energy of the isochoric invariants.

    With C = m I + A, A the deviator, and T = F - m F^-T = F - cof F + (J - m)/J cof F, they are
    dI1/dF = 2 J^-2/3 T and dI2/dF = 2 J^-4/3 (2 m T - F A + A:A/3 F^-T), of the isochoric I1 and
    I2: no part of them is large where the strain is small.

    Source: Bonet & Wood (2008), (6.49) to (6.55).

    Args:
        psi: Energy [J/m^3] as a function of I1 - 3 and I2 - 3, the isochoric ones.
        F: Deformation gradient, shape (3, 3).
    """
    (m, A), J = _strains_of_shape(F), ufl.det(F)
    q, inverse = J ** (-2 / 3), cofactor(F) / J
    # Rounded as 1 is, which the derivatives of psi do not see.
    first = ufl.variable(3 * m * q - 3)
    second = ufl.variable((3 * m**2 - ufl.inner(A, A) / 2) * q**2 - 3)
    energy = psi(first, second)
    by_first, by_second = q * ufl.diff(energy, first), q**2 * ufl.diff(energy, second)
    swelling = volume_change(F) - 2 / 3 * ufl.tr(green_strain(F))  # J - m
    T = less_cofactor(F) + swelling * inverse
    return 2 * (
        (by_first + 2 * m * by_second) * T + by_second * (ufl.inner(A, A) / 3 * inverse - F * A)
    )
