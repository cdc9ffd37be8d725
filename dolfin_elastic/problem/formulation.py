"""Which unknowns a problem needs: a pressure where the material hardly changes its volume."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.material_point.checks import LawUnderTest, voigt
from dolfin_elastic.model.materials.law import Law, SplitLaw
from dolfin_elastic.problem.spaces import AuxiliaryField

log = logging.getLogger("dolfin_elastic")
Formulation = Literal["auto", "displacement", "mixed"]

STIFF_IN_VOLUME = 0.45
"""Poisson's ratio above which displacements alone lose accuracy."""


@dataclass(frozen=True)
class Plan:
    """What is solved for beside the displacement.

    Attributes:
        mixed: Names of the materials whose volumetric part a pressure carries.
        auxiliary_fields: The scalar fields.
    """

    mixed: frozenset[str]
    auxiliary_fields: tuple[AuxiliaryField, ...]


def plan(
    laws: Mapping[str, Law],
    formulation: Formulation,
    degree: int,
    *,
    plane_stress: bool,
) -> Plan:
    """Decides from the materials and says so in the log.

    The pressure of quadratic elements is linear (Taylor & Hood, Computers & Fluids 1 (1973));
    with linear elements it is linear too, and stabilised.  In plane stress the volume can change
    through the thickness, and everything beside the displacement belongs to one cell.

    Raises:
        InputError: A material cannot be computed so.
    """
    nearly = {name for name, law in laws.items() if poisson(law) > STIFF_IN_VOLUME}
    exactly = {name for name, law in laws.items() if not math.isfinite(volume_modulus(law))}
    _check(laws, exactly, formulation, degree)
    split = {
        name for name, law in laws.items() if isinstance(law, SplitLaw) and volume_modulus(law) > 0
    }
    mixed: set[str] = set()
    if formulation == "mixed":
        mixed = nearly & split or split
    elif formulation == "auto" and (
        exactly or (degree > 1 and nearly & split and not plane_stress)
    ):
        mixed = exactly | (nearly & split)
    auxiliary_fields = []
    if plane_stress:
        auxiliary_fields.append(AuxiliaryField("stretch", degree - 1, continuous=False))
    if mixed:
        auxiliary_fields.append(
            AuxiliaryField("pressure", degree - 1, continuous=False)
            if plane_stress
            else AuxiliaryField("pressure", 1, continuous=True)
        )
    return Plan(frozenset(mixed), tuple(auxiliary_fields))


def _check(
    laws: Mapping[str, Law], exactly: set[str], formulation: Formulation, degree: int
) -> None:
    for name in sorted(exactly):
        if not isinstance(laws[name], SplitLaw):
            raise InputError(
                f"the law '{laws[name].name()}' cannot be incompressible",
                where=f"materials.{name}.nu",
                expected="nu must lie below 0.5: it has no volumetric part",
            )
        if formulation == "displacement" or (formulation == "auto" and degree == 1):
            raise InputError(
                "an incompressible material needs a pressure beside the displacement",
                where=f"materials.{name}.nu",
                expected='mesh.formulation = "mixed" or mesh.degree = 2, or nu below 0.5',
            )
    carried = (isinstance(law, SplitLaw) and volume_modulus(law) > 0 for law in laws.values())
    if formulation == "mixed" and not any(carried):
        raise InputError(
            "no material has a volumetric part that a pressure could carry",
            where="mesh.formulation",
            expected='"displacement"',
        )


def locking(nu: float, cells_across: float) -> tuple[float, float]:
    """How many times too stiff a body of linear elements may be: from, to.

    Without a pressure of its own each linear cell keeps its volume, and a body of them can hardly
    bend or twist.  What this costs grows with x = lmbda/mu (h/L)^2, h the size of a cell and L that
    of the body.  Found at nu = 0.4999: a tube under pressure 0.013 x, Cook's membrane 0.06 x to
    0.8 x, a cylinder twisted 2 x.
    """
    x = 2 * nu / max(1 - 2 * nu, 1e-9) / cells_across**2
    return 1 + 0.013 * x, 1 + 2 * x


def describe(plan: Plan, degree: int) -> str:
    """The unknowns of a mixed problem in words, for the log."""
    pressure = next(extra for extra in plan.auxiliary_fields if extra.name == "pressure")
    kind = "P" if pressure.continuous else "DG"
    stabilised = ", stabilised" if pressure.continuous and degree == 1 else ""
    return (
        f"displacement P{degree} and pressure {kind}{pressure.degree}{stabilised} "
        f"(nearly incompressible: {', '.join(sorted(plan.mixed))})"
    )


def volume_modulus(law: Law) -> float:
    """Bulk modulus of a law with a volumetric part of its own [Pa]; 0 without one."""
    if math.inf in law.constants().values():
        return math.inf
    return float(getattr(law, law.volume_modulus)) if isinstance(law, SplitLaw) else 0.0


def poisson(law: Law) -> float:
    """Poisson's ratio at small strains; 0 where a law has no volumetric part."""
    if (known := law.small_strain()) is not None:
        return known.nu
    if not isinstance(law, SplitLaw):
        return 0.0
    k, mu = volume_modulus(law), shear_modulus(law)
    return 0.5 if math.isinf(k) else (3 * k - 2 * mu) / (2 * (3 * k + mu))


def shear_modulus(law: Law) -> float:
    """Shear modulus at small strains, of anisotropic laws a mean [Pa]."""
    if (known := law.small_strain()) is not None:
        return known.mu
    with np.errstate(all="ignore"):
        stiffness = voigt(LawUnderTest(law).rest)
    mu = float(np.mean(np.diag(stiffness)[3:]))
    return mu if np.isfinite(mu) and mu > 0 else 1.0


def young(law: Law) -> float:
    """Young's modulus at small strains, of anisotropic laws about [Pa]."""
    return 2 * (1 + poisson(law)) * shear_modulus(law)
